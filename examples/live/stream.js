// Prints corrected samples of the phone that a running stillcal daemon serves: sensor, t, x, y, z.
//
//     node stream.js [SOCKET]
//
// Node's own library is enough. Varlink is JSON with a zero byte after each message.

"use strict";
const net = require("net");

const line = net.createConnection(process.argv[2] || "/run/stillcal/io.stillcal.Calibration");
const question = { method: "io.stillcal.Calibration.Stream", parameters: { batch_s: 0.02 }, more: true };
line.write(JSON.stringify(question) + "\0");

let complete = false;
let unread = Buffer.alloc(0);
line.on("data", (data) => {
  unread = Buffer.concat([unread, data]);
  for (let end = unread.indexOf(0); end >= 0; end = unread.indexOf(0)) {
    show(JSON.parse(unread.subarray(0, end).toString()));
    unread = unread.subarray(end + 1);
  }
});
process.stdout.on("error", () => process.exit(0)); // what is printed is no longer read
line.on("error", (error) => {
  console.error(error.message);
  process.exitCode = 1;
});

line.on("close", () => {
  if (!complete && !process.exitCode) {
    console.error("the daemon has gone");
    process.exitCode = 1;
  }
});

function show(reply) {
  if (reply.error) { // TooSlow: this program did not read fast enough
    console.error(reply.error);
    process.exitCode = 1;
    line.destroy();
    return;
  }
  const block = reply.parameters.block;
  if (block.notice) console.error(block.notice);
  const name = block.calibrated ? block.sensor : "raw_" + block.sensor;
  for (const row of block.samples || []) console.log(name, ...row.map(String));
  complete = !reply.continues;
}
