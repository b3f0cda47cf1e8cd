// Uses a server for viewers through the client class of @foxglove/ws-protocol, and prints what it found as one line of JSON.
// Prints `ready` when it waits for a message of /joint_states.
//
// Usage: DOWNBEAT_NODE_MODULES=FOLDER node look.mjs URL

import { createRequire } from "node:module";
import { join } from "node:path";

const require = createRequire(join(process.env.DOWNBEAT_NODE_MODULES, "index.js"));
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader, MessageWriter } = require("@foxglove/rosmsg2-serialization");
const { WebSocket } = require("ws");

const [, , url] = process.argv;
const watchdog = setTimeout(() => {
  console.error("the server did not answer");
  process.exit(1);
}, 20_000);

const found = { errors: [], unparsed: [], parameters: {}, subscribers: {}, providers: {} };
const client = new FoxgloveClient({ ws: new WebSocket(url, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
client.on("error", (error) => found.errors.push(String(error)));

/** The next event for which `isMeant` returns true. */
const next = (event, isMeant = () => true) =>
  new Promise((resolve) => {
    const listener = (value) => {
      if (isMeant(value)) {
        client.off(event, listener);
        resolve(value);
      }
    };
    client.on(event, listener);
  });

const definitions = (schema) => parse(schema, { ros2: true });
const first = [next("serverInfo"), next("advertise"), next("advertiseServices")];
const [info, channels, services] = await Promise.all(first);
found.info = info;
for (const { schemaName, schema } of channels) {
  try {
    new MessageReader(definitions(schema));
  } catch (error) {
    found.unparsed.push([schemaName, String(error)]);
  }
}

/** The first message of a topic. */
const message = async (topic, isSubscribed) => {
  const channel = channels.find((channel) => channel.topic === topic);
  const id = client.subscribe(channel.id);
  const received = next("message", ({ subscriptionId }) => subscriptionId === id);
  await isSubscribed?.();
  const { data } = await received;
  client.unsubscribe(id);
  return new MessageReader(definitions(channel.schema)).readMessage(data);
};

const fetchAsset = (uri, requestId) => {
  const answer = next("fetchAssetResponse", (response) => response.requestId === requestId);
  client.fetchAsset(uri, requestId);
  return answer;
};

found.description = await message("/robot_description");
found.jointState = await message("/joint_states", async () => {
  // The server serves the requests of a viewer in order.
  await fetchAsset("", 1);
  console.log("ready");
});

const contents = await fetchAsset("package://robot/arm.stl", 2);
found.asset = new TextDecoder().decode(contents.data);
found.noAsset = (await fetchAsset("package://robot/../secret", 3)).error;

const stand = services.find(({ name }) => name === "/stand");
const call = (callId, data) => {
  const writer = new MessageWriter(definitions(stand.request.schema));
  client.sendServiceCallRequest({
    serviceId: stand.id,
    callId,
    encoding: stand.request.encoding,
    data: new DataView(writer.writeMessage({ data }).slice().buffer),
  });
};
const response = next("serviceCallResponse", ({ callId }) => callId === 1);
call(1, true);
const { data } = await response;
found.response = new MessageReader(definitions(stand.response.schema)).readMessage(data);
const failure = next("serviceCallFailure", ({ callId }) => callId === 2);
call(2, false);
found.failure = (await failure).message;

const all = next("parameterValues", ({ id }) => id === "all");
client.getParameters([], "all");
for (const { name, value } of (await all).parameters) {
  found.parameters[name] = value;
}
const watched = next("parameterValues", ({ id, parameters }) => id == undefined && parameters[0].value === 2.5);
client.subscribeParameterUpdates(["legs.gain"]);
const set = next("parameterValues", ({ id }) => id === "set");
client.setParameters([{ name: "legs.gain", value: 2.5, type: "float64" }], "set");
found.set = (await set).parameters;
found.watched = (await watched).parameters[0].value;
client.unsubscribeParameterUpdates(["legs.gain"]);

const graph = next("connectionGraphUpdate");
client.subscribeConnectionGraph();
const { subscribedTopics, advertisedServices } = await graph;
subscribedTopics.forEach(({ name, subscriberIds }) => (found.subscribers[name] = subscriberIds));
advertisedServices.forEach(({ name, providerIds }) => (found.providers[name] = providerIds));
client.unsubscribeConnectionGraph();

const twist = channels.find(({ topic }) => topic === "/cmd_vel");
const velocity = (x) => ({ linear: { x, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0 } });
const { topic, schemaName } = twist;
const inCdr = client.advertise({ topic, schemaName, encoding: "cdr" });
client.sendMessage(inCdr, new MessageWriter(definitions(twist.schema)).writeMessage(velocity(0.25)));
const inJson = client.advertise({ topic, schemaName, encoding: "json" });
client.sendMessage(inJson, new TextEncoder().encode(JSON.stringify(velocity(0.75))));
client.unadvertise(inCdr);
client.unadvertise(inJson);
await fetchAsset("", 4);
// A second answer of the core: what was published before has been delivered.
const settled = next("parameterValues", ({ id }) => id === "settled");
client.getParameters(["legs.gain"], "settled");
await settled;

console.log(JSON.stringify(found));
clearTimeout(watchdog);
client.close();
