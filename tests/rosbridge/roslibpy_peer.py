"""A program as its user would write it, with roslibpy and nothing of this project: `roslibpy_peer.py PORT`.

Prints one JSON object with what it saw.
"""

import json
import sys
import threading

import roslibpy

seen = {}
ros = roslibpy.Ros("127.0.0.1", int(sys.argv[1]))
ros.run(10)


def wait_for(event):
    assert event.wait(20), seen


heard = threading.Event()
levels = []
listener = roslibpy.Topic(ros, "/battery_level", "std_msgs/Float32")


def take(message):
    levels.append(message["data"])
    if len(levels) == 5:
        heard.set()


listener.subscribe(take)
wait_for(heard)
seen["levels"] = levels[:5]
seen["topics"] = ros.get_topics()
seen["type"] = ros.get_topic_type("/battery_level")
seen["nodes"] = ros.get_nodes()
seen["services"] = [name for name in ros.get_services() if not name.startswith("/rosapi")]
seen["details"] = ros.get_message_details("std_msgs/Float32")["typedefs"][0]["fieldnames"]
seen["parameters"] = ros.get_params()
seen["rate"] = ros.get_param("/rosbridge:rate")
seen["time"] = sorted(ros.get_time())

reset = roslibpy.Service(ros, "/robot/reset", "std_srvs/Trigger")
seen["reset"] = dict(reset.call(roslibpy.ServiceRequest()))
try:
    roslibpy.Service(ros, "/robot/shutdown", "std_srvs/Trigger").call(roslibpy.ServiceRequest())
except Exception as error:
    seen["refused"] = str(error)

talker = roslibpy.Topic(ros, "/in", "std_msgs/Float32")
echoed = threading.Event()
echo = roslibpy.Topic(ros, "/in", "std_msgs/Float32")
echo.subscribe(lambda message: (seen.update(echo=message["data"]), echoed.set()))
talker.advertise()
for _ in range(100):
    talker.publish(roslibpy.Message({"data": 3.5}))
    if echoed.wait(0.1):
        break
wait_for(echoed)

offered = roslibpy.Service(ros, "/offered", "std_srvs/SetBool")


def answer(request, response):
    response["success"] = request["data"]
    response["message"] = "from roslibpy"
    return True


offered.advertise(answer)
other = roslibpy.Ros("127.0.0.1", int(sys.argv[1]))
other.run(10)
answers = []
answered = threading.Event()
for _ in range(100):  # until it is known on the other side
    try:
        call = roslibpy.Service(other, "/offered", "std_srvs/SetBool")
        seen["offered"] = dict(call.call(roslibpy.ServiceRequest({"data": True}), timeout=10))
        break
    except Exception:
        answered.wait(0.1)

offered.unadvertise()
talker.unadvertise()
listener.unsubscribe()
print(json.dumps(seen), flush=True)
ros.terminate()
