// Calls the service /level and the action /turn of a robot through the client class of @foxglove/ws-protocol, with the definitions that the server sent, and
// prints the response to a tilt of 0.75, why there is none to one of 9, and the end of a goal, as one line of JSON.
//
// Usage: DOWNBEAT_NODE_MODULES=FOLDER node own_service.mjs URL

import { createRequire } from "node:module";
import { join } from "node:path";

const require = createRequire(join(process.env.DOWNBEAT_NODE_MODULES, "index.js"));
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader, MessageWriter } = require("@foxglove/rosmsg2-serialization");
const { WebSocket } = require("ws");

const watchdog = setTimeout(() => {
  console.error("the server did not answer");
  process.exit(1);
}, 20_000);
const client = new FoxgloveClient({ ws: new WebSocket(process.argv[2], [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
const next = (event, isMeant) =>
  new Promise((resolve) => {
    client.on(event, (value) => {
      if (isMeant(value)) resolve(value);
    });
  });
const services = await next("advertiseServices", () => true);
const definitions = (part) => parse(part.schema, { ros2: true });
let lastId = 0;
/** The response of a service, or the words of a failure. */
const call = async (name, request) => {
  const service = services.find((service) => service.name === name);
  const callId = ++lastId;
  const isMeant = (answer) => answer.callId === callId;
  const answered = Promise.race([next("serviceCallResponse", isMeant), next("serviceCallFailure", isMeant)]);
  const data = new DataView(new MessageWriter(definitions(service.request)).writeMessage(request).slice().buffer);
  client.sendServiceCallRequest({ serviceId: service.id, callId, encoding: service.request.encoding, data });
  const { data: answer, message } = await answered;
  return message ?? new MessageReader(definitions(service.response)).readMessage(answer);
};

const tilt = (angle) => ({ tilt: { header: { stamp: { sec: 0, nanosec: 0 }, frame_id: "wall" }, angle } });
const response = await call("/level", tilt(0.75));
const message = await call("/level", tilt(9));
const goal_id = { uuid: Array.from({ length: 16 }, (_, index) => index) };
const { accepted } = await call("/turn/_action/send_goal", { goal_id, goal: { angle: 1.5 } });
const { status, result } = await call("/turn/_action/get_result", { goal_id });
const { type } = services.find(({ name }) => name === "/level");
console.log(JSON.stringify({ type, response, message, accepted, status, turned: result.turned }));
clearTimeout(watchdog);
client.close();
