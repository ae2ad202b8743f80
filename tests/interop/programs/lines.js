// A line of JSON for each question, one for each answer; it all ends with standard input.
"use strict";

const { createInterface } = require("readline");

// What libraries have to say goes elsewhere: load this before them.
globalThis.console = new console.Console(process.stderr);

const tell = (said) => process.stdout.write(JSON.stringify(said) + "\n");
const failed = (error) => tell({ error: String((error && error.stack) || error) });

exports.converse = async function converse(start) {
  let last;
  try {
    const { greeting, answer } = await start();
    tell({ ok: greeting ?? null });
    last = answer;
  } catch (error) {
    failed(error);
    process.exit(1);
  }
  let queue = Promise.resolve();
  createInterface({ input: process.stdin })
    .on("line", (line) => {
      queue = queue.then(() => last(JSON.parse(line))).then((said) => tell({ ok: said ?? null }), failed);
    })
    .on("close", () => process.exit(0));
};
