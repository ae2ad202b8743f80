// modbus-serial: "master tcp HOST PORT", "master rtu PATH BAUD", or "slave".
"use strict";

const { converse } = require("./lines");
const Modbus = require("modbus-serial");

const SIZE = 200;
const MS = 10000;
const [part, ...where] = process.argv.slice(2);

async function master() {
  const client = new Modbus();
  if (where[0] === "tcp") await client.connectTCP(where[1], { port: Number(where[2]) });
  else await client.connectRTUBuffered(where[1], { baudRate: Number(where[2]) });
  client.setID(1);
  client.setTimeout(MS);
  const reads = {
    coil: "readCoils", discrete: "readDiscreteInputs", holding: "readHoldingRegisters", input: "readInputRegisters",
  };
  const told = async (asked) => {
    try {
      return await asked;
    } catch (error) {
      if (error.modbusCode === undefined) throw error;
      return { refused: error.modbusCode };
    }
  };
  const answer = async ({ read, write }) => {
    if (read) {
      const [table, address, count] = read;
      const found = await told(client[reads[table]](address, count));
      return found.refused ? found : found.data.slice(0, count).map(Number);
    }
    const [table, address, values] = write;
    const one = table === "coil" ? "writeCoil" : "writeRegister";
    const many = values.map((value) => (table === "coil" ? Boolean(value) : value));
    const done = many.length === 1 ? client[one](address, many[0]) : client[one + "s"](address, many);
    const { refused } = await told(done);
    return refused ? { refused } : null;
  };
  return { answer };
}

async function slave() {
  const tables = {};
  for (const table of ["coil", "discrete", "input", "holding"]) tables[table] = new Array(SIZE).fill(0);
  const at = (table, address) => {
    if (address < SIZE) return tables[table][address];
    throw Object.assign(new Error("no such address"), { modbusErrorCode: 2 });
  };
  const set = (table, address, value) => {
    at(table, address);
    tables[table][address] = Number(value);
  };
  const vector = {
    getCoil: (address) => Boolean(at("coil", address)),
    getDiscreteInput: (address) => Boolean(at("discrete", address)),
    getInputRegister: (address) => at("input", address),
    getHoldingRegister: (address) => at("holding", address),
    setCoil: (address, value) => set("coil", address, value),
    setRegister: (address, value) => set("holding", address, value),
  };
  const server = new Modbus.ServerTCP(vector, { host: "127.0.0.1", port: 0, unitID: 1 });
  await new Promise((resolve, reject) => server.on("initialized", resolve).on("serverError", reject));
  const answer = ({ set: filled, get: asked }) => {
    const [table, address, what] = filled || asked;
    if (filled) what.forEach((value, k) => (tables[table][address + k] = value));
    return filled ? what : tables[table].slice(address, address + what);
  };
  return { greeting: server._server.address().port, answer };
}

converse(part === "master" ? master : slave);
