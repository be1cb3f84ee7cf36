"""Why a topic brings no samples, as far as the ROS master knows."""

from __future__ import annotations

import threading
from typing import Callable, Container, Dict, Mapping, Optional, Tuple

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.hints import Answer, explain, similar_topics

from .master import Master


class PublisherLookup:
    """Asks the master in a thread, which ends when it has answered: neither a callback nor a tick waits for it."""

    def __init__(self, master: Master, own_topics: Callable[[], Container[str]]) -> None:
        """Asks nothing yet; `own_topics` returns the resolved topics that the node itself uses, in the thread."""
        self._master = master
        self._own_topics = own_topics
        self._lock = threading.Lock()
        self._questions: Dict[Tuple[str, str], Answer] = {}
        self._is_asking = False

    def look_up(self, topic: str, type_name: str, answer: Answer) -> None:
        """Answers later: why a topic brings no samples; None if nothing is known. See `core.hints.Hints`."""
        with self._lock:
            self._questions[topic, type_name] = answer
            if not self._is_asking:
                threading.Thread(target=self._ask, name="publisher lookup", daemon=True).start()
                self._is_asking = True

    def _ask(self) -> None:
        while True:
            with self._lock:
                questions, self._questions = self._questions, {}
                if not questions:
                    self._is_asking = False
                    return
            published = self._published()
            own = self._own_topics()
            for (topic, type_name), answer in questions.items():
                answer(None if published is None else _explain(topic, type_name, published, own))

    def _published(self) -> Optional[Mapping[str, str]]:
        """Returns the type of each topic that has a publisher; None: the master does not answer."""
        try:
            publishers, _, _ = self._master.system_state()
            types = self._master.topic_types()
        except ServiceError:
            return None
        return {topic: types.get(topic, "") for topic, nodes in publishers if nodes}


def _explain(topic: str, type_name: str, published: Mapping[str, str], own: Container[str]) -> Optional[str]:
    found = [published[topic]] if topic in published else []
    return explain(topic, type_name, found, similar_topics(topic, type_name, published, own))
