"""Prints corrected samples of the phone that a running stillcal daemon serves: sensor, t, x, y, z.

    python3 stream.py [SOCKET]

Python's own library is enough. Varlink is JSON with a zero byte after each message.
"""

import json
import signal
import socket
import sys


def messages(line):
    """Yield the daemon's replies until it closes the connection."""
    unread = b""
    while data := line.recv(65536):
        *complete, unread = (unread + data).split(b"\0")
        yield from map(json.loads, complete)


def show(block):
    if "notice" in block:
        print(block["notice"], file=sys.stderr)
    for row in block.get("samples", []):
        print(
            block["sensor"] if block["calibrated"] else f"raw_{block['sensor']}", *map(repr, row), flush=True
        )


signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # end quietly where what is printed is no longer read
address = sys.argv[1] if len(sys.argv) > 1 else "/run/stillcal/io.stillcal.Calibration"
with socket.socket(socket.AF_UNIX) as line:
    line.connect(address)
    question = {"method": "io.stillcal.Calibration.Stream", "parameters": {"batch_s": 0.02}, "more": True}
    line.sendall(json.dumps(question).encode() + b"\0")
    for reply in messages(line):
        if "error" in reply:  # TooSlow: this program did not read fast enough
            sys.exit(reply["error"])
        show(reply["parameters"]["block"])
        if not reply.get("continues"):
            break
    else:
        sys.exit("the daemon has gone")
