// ads-client: "HOST NETID PORT". Reads and writes symbols by what the device says of them, in one request or in sums.
"use strict";

const { converse } = require("./lines");
const { Client } = require("ads-client");

const [host, netid, port] = process.argv.slice(2);

converse(async () => {
  const client = new Client({
    targetAmsNetId: netid, targetAdsPort: Number(port), routerAddress: host, routerTcpPort: 48898,
    localAmsNetId: "127.0.0.1.9.1", localAdsPort: 32750,
    rawClient: true, autoReconnect: false, hideConsoleWarnings: true, timeoutDelay: 10000,
  });
  await client.connect();
  const place = async (name) => {
    const { indexGroup, indexOffset, size, type, adsDataType } = await client.getSymbol(name);
    return { indexGroup, indexOffset, size, type, adsDataType };
  };
  const hex = (found) => {
    if (!found.success) throw new Error(found.errorStr);
    return found.value.toString("hex");
  };
  const answer = async ({ who, symbol, read, write, missing }) => {
    if (who) return { info: await client.readDeviceInfo(), state: (await client.readState()).adsStateStr };
    if (symbol) return place(symbol);
    if (missing) return place(missing).then(() => "found", (error) => String(error.adsError && error.adsError.errorStr));
    if (read && read.length === 1) {
      const { indexGroup, indexOffset, size } = await place(read[0]);
      return [(await client.readRaw(indexGroup, indexOffset, size)).toString("hex")];
    }
    if (read) return (await client.readRawMulti(await Promise.all(read.map(place)))).map(hex);
    const orders = [];
    for (const [name, value] of write) orders.push({ ...(await place(name)), value: Buffer.from(value, "hex") });
    const told = await client.writeRawMulti(orders);
    return told.map((one) => one.success);
  };
  return { greeting: client.connection.localAmsNetId, answer };
});
