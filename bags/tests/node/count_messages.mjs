// Reads the files of bags with @mcap/core, checksums included, and decodes messages with @foxglove/rosmsg2-serialization where
// the schema is `ros2msg`. Prints for each bag the number of messages of each topic, or why it cannot be read.
//
// Usage: DOWNBEAT_NODE_MODULES=FOLDER node count_messages.mjs FOLDER, whose folders and files are the bags.

import { open, readdir, stat } from "node:fs/promises";
import { createRequire } from "node:module";
import { join } from "node:path";

const require = createRequire(join(process.env.DOWNBEAT_NODE_MODULES, "index.js"));
const { McapIndexedReader } = require("@mcap/core");
const { FileHandleReadable } = require("@mcap/nodejs");
const { loadDecompressHandlers } = require("@mcap/support");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

async function count(path, counts) {
  const file = await open(path, "r");
  const readable = new FileHandleReadable(file);
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: await loadDecompressHandlers() });
  const decoders = new Map();
  for (const schema of reader.schemasById.values()) {
    if (schema.encoding === "ros2msg") {
      const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
      decoders.set(schema.id, new MessageReader(definition));
    }
  }
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    const channel = reader.channelsById.get(message.channelId);
    decoders.get(channel.schemaId)?.readMessage(message.data);
    counts[channel.topic] = (counts[channel.topic] ?? 0) + 1;
  }
  await file.close();
}

const folder = process.argv[2];
const found = {};
for (const bag of await readdir(folder)) {
  found[bag] = {};
  try {
    const path = join(folder, bag);
    const names = (await stat(path)).isFile() ? [""] : await readdir(path);
    for (const file of names.map((name) => join(path, name)).filter((file) => file.endsWith(".mcap"))) {
      await count(file, found[bag]);
    }
  } catch (error) {
    found[bag] = String(error);
  }
}
console.log(JSON.stringify(found));
