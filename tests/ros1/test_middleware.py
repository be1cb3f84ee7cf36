"""What the port over rospy does beyond the port's promises: names, parameters, types, publishers as ROS 1 has them."""

from __future__ import annotations

import socket
import sys
import threading
from typing import Any, Iterator

import pytest
from harness.line_process import LineProcess
from harness.port_conformance import FLOAT32, TRIGGER, Recorder, RefusingNode
from harness.raw_conformance import Capture

from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ConfigError


@pytest.fixture
def ros(ros_process: Any) -> Iterator[Any]:
    from harness.ros1 import Ros1Harness

    harness = Ros1Harness()
    yield harness
    harness.close()


def errors(ros: Any) -> list[str]:
    return [line.text for line in ros.log_lines() if line.severity == Severity.ERROR]


def test_a_logical_node_is_named_below_the_namespace_of_its_process(ros: Any) -> None:
    from robot_health_monitor.ros1.middleware import Ros1Middleware

    assert Ros1Middleware().name == "/tests"
    assert Ros1Middleware("alert_system").name == "/alert_system"


def test_private_parameters_stand_beside_those_of_the_file(ros: Any, parameters: Any) -> None:
    given = {"signals": {"fan": {"warn_below": 900.0}}}
    node = ros.node("alert_system", parameters=given)
    parameters("/alert_system/publish_rate", 5.0)
    parameters("/alert_system/signals/fan/unit", "rpm")
    assert node.given_parameters() == {"publish_rate": 5.0, "signals": {"fan": {"warn_below": 900.0, "unit": "rpm"}}}


@pytest.mark.parametrize("name", ["/alert_system", "/alert_system/ros__parameters"])
def test_parameters_that_are_no_mapping_are_refused(ros: Any, parameters: Any, name: str) -> None:
    parameters(name, 7)
    with pytest.raises(ConfigError, match="got 7"):
        ros.node("alert_system").given_parameters()


def test_a_latched_message_reaches_a_later_subscription(ros: Any) -> None:
    sensor = ros.node("battery_sensor")
    assert sensor.advertise("listed", "std_msgs/String", latched=True) == "/listed"
    sensor.publish("listed", {"data": "/battery_level"})
    heard = Recorder()
    ros.node("alert_system").subscribe("listed", "std_msgs/String", heard, field="data", latched=True)
    ros.wait_until(lambda: heard.values == ["/battery_level"])


def test_advertise_returns_the_remapped_topic(ros: Any) -> None:
    node = ros.node("battery_sensor", remap={"/temperature": "/sensor_data"})
    assert node.advertise("temperature", FLOAT32) == "/sensor_data"


def test_a_refused_change_does_not_count(ros: Any, parameters: Any) -> None:
    node = ros.node("alert_system", parameters={"publish_rate": 2.0})
    refusing = RefusingNode(node)
    parameters("/alert_system/ros__parameters/publish_rate", 1000.0)
    response = ros.call("/alert_system/reload", TRIGGER)
    assert response["success"] is False
    assert response["message"].endswith("got 1000.0")
    assert node.given_parameters() == {"publish_rate": 2.0}
    assert refusing.trees == []


def test_a_closed_node_is_gone_from_the_master(ros: Any) -> None:
    node = ros.node("alert_system")
    node.advertise("out", FLOAT32)
    node.subscribe("in", FLOAT32, Recorder(), field="data")
    node.advertise_service("~reset", TRIGGER, lambda request: {})
    node.close()
    names = {name for kind in ros._master.getSystemState() for name, _ in kind}
    assert not names & {"/in", "/out", "/alert_system/reset"}


def test_a_process_publishes_one_type_on_a_topic(ros: Any) -> None:
    """rospy would silently send messages of the second type as those of the first one."""
    first, second = ros.node("aggregator"), ros.node("alert_system")
    first.advertise("out", FLOAT32)
    with pytest.raises(ConfigError, match=r"/out: expected std_msgs/Float32.*got std_msgs/Int32"):
        second.advertise("out", "std_msgs/Int32")


def test_a_topic_whose_type_was_left_out_can_be_subscribed_to_with_its_type(ros: Any) -> None:
    """The aggregator and an alert_system whose signals have no type share a process when they are composed."""
    untyped, typed, again = Recorder(), Recorder(), Recorder()
    ros.node("alert_system").subscribe("in", "", untyped, field="data")
    ros.node("aggregator").subscribe("in", FLOAT32, typed, field="data")
    ros.node("other").subscribe("in", "", again, field="data")
    ros.publish("/in", FLOAT32, {"data": 2.5})
    ros.wait_until(lambda: untyped.values == typed.values == again.values == [2.5])


def test_a_publisher_of_another_type_is_one_error_line(ros: Any) -> None:
    """Each subscription of a topic takes the messages of the type that it names."""
    untyped, typed, other = Recorder(), Recorder(), Recorder()
    node = ros.node("alert_system")
    node.subscribe("in", FLOAT32, typed, field="data")
    node.subscribe("in", "", untyped, field="data")
    node.subscribe("in", "std_msgs/Int32", other, field="data")
    ros.publish("/in", "std_msgs/Int32", {"data": 3})
    ros.publish("/in", "std_msgs/Int32", {"data": 4})
    ros.wait_until(lambda: untyped.values == [3, 4])
    ros.wait_until(lambda: bool(errors(ros)))
    assert errors(ros) == ["/in: expected messages of type std_msgs/Float32, got std_msgs/Int32"]
    assert typed.values == []
    assert other.values == [3, 4]


def test_numbers_are_read_from_bytes_beside_fields_that_are_not(ros: Any) -> None:
    """All subscriptions of a process to a topic share its connection, whichever comes first."""
    import rospy

    recorders = {field: Recorder() for field in ("percentage", "cell_voltage[1]", "header.frame_id", "voltage")}
    node = ros.node("alert_system")
    for field, recorder in recorders.items():
        node.subscribe("battery", "sensor_msgs/BatteryState", recorder, field=field)
    shared = rospy.topics.get_topic_manager().get_subscriber_impl("/battery").data_class
    assert issubclass(shared, rospy.AnyMsg)
    assert dict(rospy.get_published_topics()).get("/battery", shared._type) == "sensor_msgs/BatteryState"
    message = {"header": {"frame_id": "base"}, "percentage": 0.5, "voltage": 24.0, "cell_voltage": [3.5, 3.75]}
    ros.publish("/battery", "sensor_msgs/BatteryState", message)
    ros.wait_until(lambda: all(recorder.values for recorder in recorders.values()))
    assert [recorder.values for recorder in recorders.values()] == [[0.5], [3.75], ["base"], [24.0]]


def test_capture_follows_the_type_of_each_publisher_with_one_connection(ros: Any) -> None:
    """The type need not be installed here; judging and capture share one subscription of rospy."""
    import rospy
    from std_msgs.msg import Float32, Int32

    node, heard, capture = ros.node("alert_system"), Recorder(), Capture()
    node.subscribe("in", "", heard, field="data")
    node.subscribe_raw("in", "", capture)
    assert len(rospy.topics.get_topic_manager().get_subscriber_impl("/in").callbacks) == 2
    for cls, value in ((Float32, 2.5), (Int32, 3)):
        publisher = rospy.Publisher("/in", cls, queue_size=1)
        ros.wait_until(lambda publisher=publisher: publisher.get_num_connections() > 0)
        publisher.publish(cls(value))
        ros.wait_until(lambda value=value: value in heard.values and value in capture.values())
        publisher.unregister()
    assert capture.values() == heard.values == [2.5, 3]
    assert [each.schema_name for _, _, each in capture.items] == ["std_msgs/Float32", "std_msgs/Int32"]
    with pytest.raises(ConfigError, match="no_such_msgs/Float32"):
        node.subscribe("other", "no_such_msgs/Float32", Recorder(), field="data")
    node.subscribe_raw("other", "no_such_msgs/Float32", capture)


def test_messages_that_rospy_reads_itself_are_captured(ros: Any) -> None:
    import rospy
    from std_msgs.msg import Float32

    node, heard, capture = ros.node("alert_system"), Recorder(), Capture()
    other = rospy.Subscriber("/in", Float32, lambda message: None)
    node.subscribe_raw("/in", "", capture)
    node.subscribe("/in", FLOAT32, heard, field="data")
    ros.publish("/in", FLOAT32, {"data": 2.5})
    ros.wait_until(lambda: capture.values() == heard.values == [2.5])
    other.unregister()


@pytest.mark.parametrize("type_name", ["", FLOAT32])
def test_messages_that_do_not_match_their_type_are_one_error_line(ros: Any, type_name: str) -> None:
    """A publisher with the checksum of std_msgs/Float32 that sends one byte instead of four."""
    import rospy

    class Garbled(rospy.AnyMsg):  # type: ignore[misc]
        _type = "std_msgs/Float32"
        _md5sum = "73fcbf46b49191e672908e50842a83d4"

    node, recorder = ros.node("alert_system"), Recorder()
    if type_name:  # a subscription that only counts makes the process read bytes
        node.subscribe("/garbled", "", Recorder(), field=None)
    node.subscribe("/garbled", type_name, recorder, field="data")
    publisher = rospy.Publisher("/garbled", Garbled, queue_size=100)
    ros.wait_until(lambda: publisher.get_num_connections() > 0)
    for data in (b"\0", b"\0", b"\0", b"\0\0\x9c\x41"):
        message = Garbled()
        message._buff = data
        publisher.publish(message)
    ros.wait_until(lambda: recorder.values == [19.5] and bool(errors(ros)))  # log lines come over /rosout
    publisher.unregister()
    assert len(errors(ros)) == 1
    assert errors(ros)[0].startswith("/garbled: a message does not match its type: ")


def test_log_lines_about_a_failed_callback_are_one_line_each(ros: Any) -> None:
    def fail(value: Any, now_s: float) -> None:
        raise RuntimeError("first\nsecond")

    ros.node("alert_system").subscribe("in", FLOAT32, fail, field="data")
    ros.publish("/in", FLOAT32, {"data": 1.0})
    ros.wait_until(lambda: bool(errors(ros)))
    assert errors(ros) == ["RuntimeError in a callback: first second"]


def test_a_type_of_a_package_that_is_not_installed_is_rejected(ros: Any) -> None:
    node = ros.node("alert_system")
    with pytest.raises(ConfigError, match="no_such_msgs/Float32"):
        node.advertise("out", "no_such_msgs/Float32")
    with pytest.raises(ConfigError, match="no_such_msgs/Float32"):
        node.subscribe("in", "no_such_msgs/Float32", Recorder(), field="data")


class Answers:
    """What was answered, by topic."""

    def __init__(self, expected: int) -> None:
        self.texts: dict[str, str | None] = {}
        self.threads: list[threading.Thread] = []
        self._expected = expected
        self._complete = threading.Event()

    def of(self, topic: str) -> Any:
        def answer(text: str | None) -> None:
            self.texts[topic] = text
            self.threads.append(threading.current_thread())
            if len(self.texts) == self._expected:
                self._complete.set()

        return answer

    def wait(self) -> None:
        assert self._complete.wait(30.0), self.texts


def lookup(uri: str, monkeypatch: pytest.MonkeyPatch, timeout_s: float = 10.0) -> Any:
    from robot_health_monitor.ros1.master import Master
    from robot_health_monitor.ros1.middleware import PublisherLookup

    monkeypatch.setenv("ROS_MASTER_URI", uri)
    return PublisherLookup(Master("/tests", timeout_s), lambda topic: ())


def test_each_question_is_answered_by_the_master_in_another_thread(
    master: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    publishers = lookup(master.uri, monkeypatch)
    for _ in range(2):  # the second time with a new thread
        answers = Answers(3)
        publishers.look_up("/none", "std_msgs/Float32", answers.of("/none"))
        publishers.look_up("/rosout_agg", "rosgraph_msgs/Log", answers.of("/rosout_agg"))
        publishers.look_up("/rosout_agg", "std_msgs/Float32", answers.of("wrong type"))
        answers.wait()
        assert answers.texts == {
            "/none": "no publisher on /none",
            "/rosout_agg": None,
            "wrong type": "/rosout_agg is published as rosgraph_msgs/Log, configured as std_msgs/Float32",
        }
        for thread in answers.threads:
            assert thread is not threading.current_thread()
            thread.join(30.0)


def test_a_master_that_hangs_gives_no_reason_and_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as hanging:
        hanging.bind(("127.0.0.1", 0))
        hanging.listen()
        publishers = lookup(f"http://127.0.0.1:{hanging.getsockname()[1]}", monkeypatch, timeout_s=0.2)
        answers = Answers(50)
        for number in range(50):
            publishers.look_up(f"/topic_{number}", "std_msgs/Float32", answers.of(f"/topic_{number}"))
        answers.wait()
        assert set(answers.texts.values()) == {None}
        assert len(set(answers.threads)) == 1


def test_a_master_that_is_down_gives_no_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = Answers(1)
    lookup("http://127.0.0.1:9", monkeypatch).look_up("/battery", "std_msgs/Float32", answers.of("/battery"))
    answers.wait()
    assert answers.texts == {"/battery": None}


def test_the_hint_of_a_silent_topic_names_the_process_that_is_gone(ros: Any, master: Any) -> None:
    code = """
import rospy, std_msgs.msg
rospy.init_node("lidar_driver")
publisher = rospy.Publisher("/hint/scan", std_msgs.msg.Float32, queue_size=1)
while not rospy.is_shutdown():
    publisher.publish(1.0)
    rospy.rostime.wallsleep(0.05)
"""
    node, heard = ros.node("alert_system"), Recorder()
    node.subscribe("/hint/scan", "std_msgs/Float32", heard, field="data")
    process = LineProcess([sys.executable, "-c", code], master.environment)
    try:
        ros.wait_until(lambda: bool(heard.values))
    finally:
        process.end()
    ros.wait_until(lambda: node.why_silent("/hint/scan", "std_msgs/Float32") == "node /lidar_driver is gone")
