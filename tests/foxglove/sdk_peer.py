"""The server of PyPI's foxglove-sdk, run as a program: a battery that falls by 1 % every 20 ms, in CDR and in JSON.

It prints its port, and ends when its stdin does. It lies in a folder without a package `foxglove`.
"""

import struct
import sys
import threading

import foxglove

ended = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
server = foxglove.start_server(host="127.0.0.1", port=0)
schema = foxglove.Schema(name="std_msgs/msg/Float32", encoding="ros2msg", data=b"float32 data\n")
battery = foxglove.Channel("/battery", message_encoding="cdr", schema=schema)
voltage = foxglove.Channel("/voltage", schema={"type": "object", "properties": {"data": {"type": "number"}}})
picture = foxglove.Schema(name="Picture", encoding="protobuf", data=b"\x0a")
unread = foxglove.Channel("/picture", message_encoding="protobuf", schema=picture)
print(server.port, flush=True)
level = 100.0
while not ended.wait(0.02):
    level = max(5.0, level - 1.0)
    battery.log(b"\x00\x01\x00\x00" + struct.pack("<f", level))
    voltage.log({"data": 12.5})
    unread.log(b"\x08\x01")
server.stop()
