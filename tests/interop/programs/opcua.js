// node-opcua: "server", whose variables the test sets and gets, or "client URL".
"use strict";

const { converse } = require("./lines");
const { mkdtempSync, rmSync } = require("fs");
const { tmpdir } = require("os");
const { join } = require("path");
const opcua = require("node-opcua");

const NAMESPACE = "urn:polishd:handover";
const [part, url] = process.argv.slice(2);

// It makes itself certificates; none of them is used.
const folder = mkdtempSync(join(tmpdir(), "node-opcua-"));
process.on("exit", () => rmSync(folder, { recursive: true, force: true }));
const certificates = (name) =>
  new opcua.OPCUACertificateManager({ rootFolder: join(folder, name), automaticallyAcceptUnknownCertificate: true });

// [[name, type, writable], ...] comes as the first question.
async function server() {
  const made = new opcua.OPCUAServer({
    port: 0, hostname: "127.0.0.1", resourcePath: "", serverCertificateManager: certificates("own"),
    userCertificateManager: certificates("users"),
    securityModes: [opcua.MessageSecurityMode.None], securityPolicies: [opcua.SecurityPolicy.None],
    buildInfo: { manufacturerName: "others", productName: "PLC", softwareVersion: "1.2" }, allowAnonymous: true,
    disableDiscovery: true,
  });
  await made.initialize();
  const values = {};
  const types = {};
  const space = made.engine.addressSpace;
  const own = space.registerNamespace(NAMESPACE);
  const device = own.addObject({ organizedBy: space.rootFolder.objects, browseName: "polishd" });
  const add = ([name, type, value, writable]) => {
    values[name] = value;
    types[name] = type;
    const get = () => new opcua.Variant({ dataType: type, value: values[name] });
    const set = ({ value: written }) => {
      values[name] = written;
      return opcua.StatusCodes.Good;
    };
    own.addVariable({
      componentOf: device, nodeId: `s=${name}`, browseName: name, dataType: type,
      accessLevel: writable ? "CurrentRead | CurrentWrite" : "CurrentRead",
      userAccessLevel: writable ? "CurrentRead | CurrentWrite" : "CurrentRead",
      value: writable ? { get, set } : { get },
    });
  };
  await made.start();
  const answer = ({ variables, set, get }) => {
    if (variables) return variables.forEach(add);
    if (set) return void Object.assign(values, set);
    return get.map((name) => values[name]);
  };
  return { greeting: made.endpoints[0].port, answer };
}

async function client() {
  const made = opcua.OPCUAClient.create({
    endpointMustExist: false, clientCertificateManager: certificates("client"),
    connectionStrategy: { maxRetry: 0, initialDelay: 100 },
    securityMode: opcua.MessageSecurityMode.None, securityPolicy: opcua.SecurityPolicy.None,
  });
  await made.connect(url);
  const session = await made.createSession();
  const index = (await session.readNamespaceArray()).indexOf(NAMESPACE);
  const node = (name) => `ns=${index};s=${name}`;
  const answer = async ({ browse, read, write, walk, whole }) => {
    if (walk) {
      let at = opcua.resolveNodeId("ObjectsFolder");
      for (const name of walk) {
        const { references } = await session.browse(at);
        const found = references.find(({ browseName }) => browseName.name === name);
        if (!found) return ["absent", name];
        at = found.nodeId;
      }
      const { statusCode, value } = await session.read({ nodeId: at, attributeId: opcua.AttributeIds.Value });
      if (whole) return [statusCode.name, value ? value.value : null]; // a structure, as its class writes it
      return [statusCode.name, value ? value.value && (value.value.text || value.value.toString()) : null];
    }
    if (browse) {
      const objects = (await session.browse("ObjectsFolder")).references;
      const polishd = objects.find(({ browseName }) => browseName.name === "polishd");
      const found = await session.browse(polishd.nodeId.toString());
      return found.references.map(({ browseName }) => browseName.name).sort();
    }
    if (read) {
      const asked = read.map((name) => ({ nodeId: node(name), attributeId: opcua.AttributeIds.Value }));
      return (await session.read(asked)).map(({ statusCode, value }) =>
        statusCode.isGood() ? [opcua.DataType[value.dataType], value.value] : [statusCode.name, null]);
    }
    const asked = write.map(([name, type, value]) => ({
      nodeId: node(name), attributeId: opcua.AttributeIds.Value, value: { value: { dataType: type, value } },
    }));
    return (await session.write(asked)).map(({ name }) => name);
  };
  return { greeting: index, answer };
}

converse(part === "server" ? server : client);
