// Looks at a bag through the client class of @foxglove/ws-protocol, which knows nothing of playback, and prints what it found as one
// line of JSON.
//
// Usage: DOWNBEAT_NODE_MODULES=FOLDER node bag.mjs URL

import { createRequire } from "node:module";
import { join } from "node:path";

const require = createRequire(join(process.env.DOWNBEAT_NODE_MODULES, "index.js"));
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const { WebSocket } = require("ws");

const [, , url] = process.argv;
const watchdog = setTimeout(() => {
  console.error("the server did not answer");
  process.exit(1);
}, 20_000);

const found = { errors: [], texts: [], times: [] };
const client = new FoxgloveClient({ ws: new WebSocket(url, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
client.on("error", (error) => found.errors.push(String(error)));
client.on("serverInfo", (info) => (found.info = info));
client.on("time", ({ timestamp }) => found.times.push(String(timestamp)));

const channels = await new Promise((resolve) => client.on("advertise", resolve));
const channel = channels.find(({ topic }) => topic === "/pose");
const reader = new MessageReader(parse(channel.schema, { ros2: true }));
await new Promise((resolve) => {
  client.on("message", ({ data }) => {
    const text = reader.readMessage(data).data;
    found.texts.push(text);
    if (text === "100") {
      resolve();
    }
  });
  client.subscribe(channel.id);
});

console.log(JSON.stringify(found));
clearTimeout(watchdog);
client.close();
