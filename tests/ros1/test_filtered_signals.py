"""Errors that rospy logs are counted, and frames of /tf are judged by themselves."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any, Iterator

import pytest

from robot_health_monitor.core.nodes import AlertSystem


@pytest.fixture
def ros(ros_process: Any) -> Iterator[Any]:
    from harness.ros1 import Ros1Harness

    harness = Ros1Harness()
    yield harness
    harness.close()


def test_errors_in_the_log_are_counted(ros: Any) -> None:
    import rospy

    signal = {
        "topic": "/rosout", "where": 'level >= ERROR and msg == "planner: *"', "field": "", "statistic": "count",
        "warn_above": 5.0,
    }  # fmt: skip
    said = []
    system = AlertSystem(
        ros.node("alert_system", parameters={"signals": {"errors": signal}}), {"test": said.append}, log_alerts=False
    )
    for number in range(6):
        rospy.logwarn("planner: slow %d", number)
        rospy.logerr("controller: failed %d", number)
        (rospy.logerr if number % 2 else rospy.logfatal)("planner: failed %d", number)
    ros.wait_until(lambda: system.read(lambda monitor, _: monitor.judgements(0.0)["errors"].judged) == 6.0)
    assert [event.text.partition(" (")[0] for event in said] == ["errors WARN: 6 in 60 s is above 5"]


DEFINITION = "geometry_msgs/TransformStamped[] transforms\n"


@pytest.fixture
def tf_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The class of tf2_msgs/TFMessage, which need not be installed: genpy's own, made from the definition."""
    import genmsg
    from genpy.generator import msg_generator
    from geometry_msgs.msg import TransformStamped

    context = genmsg.MsgContext.create_default()
    own, *parts = (
        DEFINITION + "=" * 80 + "\nMSG: geometry_msgs/TransformStamped\n" + TransformStamped._full_text
    ).split("=" * 80 + "\n")
    texts = {"tf2_msgs/TFMessage": own}
    for part in parts:
        name, _, text = part.partition("\n")
        texts[name[len("MSG: ") :]] = text
    specs = {name: genmsg.msg_loader.load_msg_from_string(context, text, name) for name, text in texts.items()}
    for name, spec in specs.items():
        context.register(name, spec)
    search_path = {name.partition("/")[0]: [str(tmp_path)] for name in texts}
    genmsg.msg_loader.load_depends(context, specs["tf2_msgs/TFMessage"], search_path)
    folder = tmp_path / "tf2_msgs" / "msg"
    folder.mkdir(parents=True)
    (tmp_path / "tf2_msgs" / "__init__.py").write_text("")
    (folder / "__init__.py").write_text("from ._TFMessage import *\n")
    code = "\n".join(msg_generator(context, specs["tf2_msgs/TFMessage"], search_path))
    (folder / "_TFMessage.py").write_text(code)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield importlib.import_module("tf2_msgs.msg").TFMessage
    for name in [name for name in sys.modules if name.partition(".")[0] == "tf2_msgs"]:
        del sys.modules[name]


@pytest.mark.parametrize("type_name", ["", "tf2_msgs/TFMessage"])
def test_a_frame_that_stops_while_tf_goes_on_is_stale(ros: Any, tf_message: Any, type_name: str) -> None:
    import rospy
    from geometry_msgs.msg import TransformStamped

    topic = f"/tf_{'typed' if type_name else 'untyped'}"
    signals = {
        "frames": {"topic": topic, "type": type_name, "field": 'transforms["*"].header.stamp', "stale_after_s": 2.0},
        "base": {"topic": topic, "type": type_name, "field": 'transforms["base_link"].header.stamp', "unit": "s"},
    }
    said: Any = []
    system = AlertSystem(ros.node("alert_system", parameters={"signals": signals}), {"test": said.append})
    publisher = rospy.Publisher(topic, tf_message, queue_size=10)
    try:
        ros.wait_until(lambda: publisher.get_num_connections() == 1)
        for second in range(101, 105):
            ros.set_time(float(second))
            names = ("base_link", "camera") if second < 102 else ("base_link",)
            stamp = rospy.Time.from_sec(second - 0.25)
            frames = [TransformStamped(child_frame_id=name) for name in names]
            for frame in frames:
                frame.header.stamp = stamp
            before = system.samples
            publisher.publish(tf_message(frames))
            ros.wait_until(lambda: system.samples == before + 2)  # noqa: B023 - it is called at once
        ros.wait_until(lambda: bool(said))
        assert [event.text for event in said] == [
            "frames[camera] STALE: no sample for 3 s (limit 2 s) (was OK for 3 s)"
        ]
        assert system.monitor.fresh_value("base") == 0.25
    finally:
        publisher.unregister()
