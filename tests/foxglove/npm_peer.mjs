// A server with npm's @foxglove/ws-protocol, which speaks foxglove.websocket.v1: a battery at 15 %, 20 times a second.
// It prints its port, and ends when its stdin does.
import { createRequire } from "node:module";

const require = createRequire(import.meta.url);
const { FoxgloveServer } = require("@foxglove/ws-protocol");
const { WebSocketServer } = require("ws");

const server = new FoxgloveServer({ name: "npm" });
const sockets = new WebSocketServer({
  port: 0,
  host: "127.0.0.1",
  handleProtocols: (protocols) => server.handleProtocols(protocols),
});
sockets.on("connection", (socket, request) => server.handleConnection(socket, request.socket.remoteAddress));
sockets.on("listening", () => console.log(sockets.address().port));
const battery = server.addChannel({
  topic: "/battery",
  encoding: "cdr",
  schemaName: "std_msgs/msg/Float32",
  schema: "float32 data",
});
const message = new Uint8Array([0, 1, 0, 0, 0, 0, 0x70, 0x41]); // 15.0
const timer = setInterval(() => server.sendMessage(battery, BigInt(Date.now()) * 1_000_000n, message), 50);
process.stdin.resume();
process.stdin.on("end", () => {
  clearInterval(timer);
  process.exit(0);
});
