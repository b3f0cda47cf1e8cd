// Reads the file of a bag with @mcap/core, by its index and as a stream, and prints what each finds: channels with their
// schemas and every message, or errors such as wrong checksums.
//
// Usage: DOWNBEAT_NODE_MODULES=FOLDER node read_bag.mjs FILE

import { open, readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { join } from "node:path";

const require = createRequire(join(process.env.DOWNBEAT_NODE_MODULES, "index.js"));
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { FileHandleReadable } = require("@mcap/nodejs");
const { loadDecompressHandlers } = require("@mcap/support");
const { crc32 } = require("@foxglove/crc");

/** What a reader has found. */
class Found {
  channels = {};
  messages = [];

  channel(channel, schemasById) {
    const schema = schemasById.get(channel.schemaId);
    this.channels[channel.topic] = {
      encoding: channel.messageEncoding,
      metadata: Object.fromEntries(channel.metadata),
      schema: { name: schema.name, encoding: schema.encoding, text: Buffer.from(schema.data).toString() },
    };
  }

  message(topic, { logTime, publishTime, data }) {
    // Times exceed the integer range of JavaScript numbers.
    this.messages.push([topic, String(logTime), String(publishTime), Buffer.from(data).toString("hex")]);
  }
}

async function indexed(path, decompressHandlers) {
  const found = new Found();
  const file = await open(path, "r");
  const readable = new FileHandleReadable(file);
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  for (const channel of reader.channelsById.values()) {
    found.channel(channel, reader.schemasById);
  }
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    found.message(reader.channelsById.get(message.channelId).topic, message);
  }
  const metadata = [];
  for await (const record of reader.readMetadata()) {
    metadata.push(record.name);
  }
  await file.close();
  // The library does not check this checksum.
  const data = await readFile(path);
  const dataCrc = crc32(data.subarray(0, Number(reader.dataEndOffset)));
  if (dataCrc !== reader.dataSectionCrc) {
    throw new Error(`the checksum of the data is ${dataCrc}, but the file declares ${reader.dataSectionCrc}`);
  }
  const { profile, library } = reader.header;
  const compressions = reader.chunkIndexes.map((chunk) => chunk.compression);
  return { ...found, profile, library, compressions, metadata, declared: Number(reader.statistics.messageCount) };
}

async function streamed(path, decompressHandlers) {
  const found = new Found();
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  const channels = new Map();
  const schemas = new Map();
  const data = await readFile(path);
  // In pieces, as received from a network.
  for (let start = 0; start < data.length; start += 1000) {
    reader.append(data.subarray(start, start + 1000));
    for (let record; (record = reader.nextRecord()); ) {
      if (record.type === "Schema") {
        schemas.set(record.id, record);
      } else if (record.type === "Channel") {
        channels.set(record.id, record);
        found.channel(record, schemas);
      } else if (record.type === "Message") {
        found.message(channels.get(record.channelId).topic, record);
      }
    }
  }
  if (!reader.done()) {
    throw new Error("the stream has no end");
  }
  return found;
}

const [, , path] = process.argv;
const handlers = await loadDecompressHandlers();
const read = async (by) => by(path, handlers).catch((error) => ({ error: String(error) }));
console.log(JSON.stringify({ indexed: await read(indexed), streamed: await read(streamed) }));
