// A program as its user would write it, with roslib and nothing of this project: roslibjs_peer.mjs PORT
// Prints one JSON object with what it saw.
import * as module from "roslib";

const ROSLIB = module.default ?? module;
const seen = {};
const ros = new ROSLIB.Ros({ url: `ws://127.0.0.1:${process.argv[2]}` });
const promised = (start) => new Promise((resolve, reject) => start(resolve, reject));

await promised((resolve, reject) => {
  ros.on("connection", resolve);
  ros.on("error", reject);
});
seen.topics = (await promised((resolve, reject) => ros.getTopics(resolve, reject))).topics;
seen.type = await promised((resolve, reject) => ros.getTopicType("/battery_level", resolve, reject));
seen.ofType = await promised((resolve, reject) => ros.getTopicsForType("std_msgs/Float32", resolve, reject));
seen.nodes = await promised((resolve, reject) => ros.getNodes(resolve, reject));
seen.services = (await promised((resolve, reject) => ros.getServices(resolve, reject))).filter(
  (name) => !name.startsWith("/rosapi"),
);
seen.serviceType = await promised((resolve, reject) => ros.getServiceType("/robot/reset", resolve, reject));
const details = await promised((resolve, reject) => ros.getMessageDetails("std_msgs/Float32", resolve, reject));
seen.details = ros.decodeTypeDefs(details);
seen.rate = await promised((resolve) => new ROSLIB.Param({ ros, name: "/rosbridge:rate" }).get(resolve));

seen.levels = {};
for (const compression of ["none", "png", "cbor"]) {
  const topic = new ROSLIB.Topic({ ros, name: "/battery_level", messageType: "std_msgs/Float32", compression });
  seen.levels[compression] = await promised((resolve) =>
    topic.subscribe((message) => {
      topic.unsubscribe();
      resolve(message.data);
    }),
  );
}

const reset = new ROSLIB.Service({ ros, name: "/robot/reset", serviceType: "std_srvs/Trigger" });
seen.reset = await promised((resolve, reject) => reset.callService({}, resolve, reject));
const shutdown = new ROSLIB.Service({ ros, name: "/robot/shutdown", serviceType: "std_srvs/Trigger" });
seen.refused = await promised((resolve) => shutdown.callService({}, resolve, resolve));

const talker = new ROSLIB.Topic({ ros, name: "/in", messageType: "std_msgs/Float32" });
const echo = new ROSLIB.Topic({ ros, name: "/in", messageType: "std_msgs/Float32" });
seen.echo = await promised((resolve) => {
  echo.subscribe((message) => resolve(message.data));
  talker.publish({ data: 3.5 });
});
console.log(JSON.stringify(seen));
ros.close();
