"""Gives corrected samples to emulators that speak DSU (Cemuhook): Dolphin, Cemu, Ryujinx and others.

    python3 dsu.py [SOCKET [PORT]]

It listens on 127.0.0.1, port 26760, and sends a packet for each sample of the gyroscope. In the emulator,
choose the DSU or Cemuhook server of that address and its first controller, which has no buttons.

Python's own library is enough. The packets are those of https://github.com/v1993/cemuhook-protocol. The axes
are those by which Dolphin reads them (DualShockUDPClient.cpp), of a phone that lies flat before the player:
what the accelerometer feels to the left, down and forward; pitch up, yaw to the right and roll to the right.
"""

import json
import math
import signal
import socket
import struct
import sys
import threading
import time
import zlib
from collections.abc import Iterator
from typing import Any

VERSION, PORTS, DATA = 0x100000, 0x100001, 0x100002
PROTOCOL, SERVER_ID = 1001, 0x57111CA1
GRAVITY = 9.80665
FORGOTTEN_S = 5.0  # a client asks again every second or so
NOT_CONNECTED = bytes(10)
CONNECTED = struct.pack("<BBB6sB", 2, 2, 0, b"\x02still", 0)  # full gyroscope; no cable, no battery
NEUTRAL = bytes([0] * 4 + [128] * 4 + [0] * 24)  # buttons, sticks, pressures, touches


def packet(kind: int, body: bytes) -> bytes:
    """Return a message with its header and check sum."""
    payload = struct.pack("<I", kind) + body
    head, tail = struct.pack("<4sHH", b"DSUS", PROTOCOL, len(payload)), struct.pack("<I", SERVER_ID) + payload
    return head + struct.pack("<I", zlib.crc32(head + bytes(4) + tail)) + tail


def answer(question: bytes) -> list[bytes]:
    """Return the replies to a client's message, none to what is not one."""
    if len(question) < 20 or question[:4] != b"DSUC":
        return []
    (kind,) = struct.unpack_from("<I", question, 16)
    if kind == VERSION:
        return [packet(VERSION, struct.pack("<H", PROTOCOL))]
    if kind == PORTS and len(question) >= 24:
        slots = question[24 : 24 + min(struct.unpack_from("<I", question, 20)[0], 4)]
        return [packet(PORTS, bytes([s]) + (NOT_CONNECTED if s else CONNECTED) + b"\0") for s in slots]
    return []


def asks_for_data(question: bytes) -> bool:
    """Whether a client's message asks for the samples of all controllers or of this one."""
    if len(question) < 28 or question[:4] != b"DSUC" or struct.unpack_from("<I", question, 16)[0] != DATA:
        return False
    by_slot, by_address = question[20] & 1, question[20] & 2
    return not (by_slot and question[21]) and not (by_address and question[22:28] != CONNECTED[3:9])


def sample(count: int, t: float, force: list[float], rate: list[float]) -> bytes:
    """Return the message of a sample. force, rate: of the phone's axes, m/s^2 and rad/s."""
    x, y, z = (value / GRAVITY for value in force)
    pitch, roll, yaw = (math.degrees(value) for value in rate)
    motion = (-x, -z, y, pitch, -yaw, roll)
    return packet(
        DATA,
        b"\0"
        + CONNECTED
        + struct.pack("<BI", 1, count & 0xFFFFFFFF)
        + NEUTRAL
        + struct.pack("<Q6f", round(t * 1e6), *motion),
    )


class Server:
    """Answers clients, and remembers for some seconds who wants samples."""

    def __init__(self, port: int) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.clients: dict[tuple[str, int], float] = {}
        self.force: list[float] | None = None
        self.count = 0

    def listen(self) -> None:
        while True:
            question, client = self.socket.recvfrom(1024)
            if asks_for_data(question):
                self.clients[client] = time.monotonic()
            for reply in answer(question):
                self.socket.sendto(reply, client)

    def show(self, block: dict[str, Any]) -> None:
        for t, *xyz in block.get("samples", []):
            if block["sensor"] == "accelerometer":
                self.force = xyz
            elif self.force is not None:
                self.count += 1
                self.send(sample(self.count, t, self.force, xyz))

    def send(self, message: bytes) -> None:
        now = time.monotonic()
        for client, asked in list(self.clients.items()):
            if now - asked < FORGOTTEN_S:
                self.socket.sendto(message, client)
            else:
                del self.clients[client]


def blocks(line: socket.socket, unread: bytes = b"") -> Iterator[dict[str, Any]]:
    """Yield the daemon's blocks until it has gone."""
    question = {"method": "io.stillcal.Calibration.Stream", "parameters": {"batch_s": 0.0}, "more": True}
    line.sendall(json.dumps(question).encode() + b"\0")
    while data := line.recv(65536):
        *complete, unread = (unread + data).split(b"\0")
        for reply in map(json.loads, complete):
            if "error" in reply:  # TooSlow: this program did not read fast enough
                sys.exit(reply["error"])
            yield reply["parameters"]["block"]


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    address = sys.argv[1] if len(sys.argv) > 1 else "/run/stillcal/io.stillcal.Calibration"
    server = Server(int(sys.argv[2]) if len(sys.argv) > 2 else 26760)
    print(f"listening on 127.0.0.1:{server.socket.getsockname()[1]}", flush=True)
    with socket.socket(socket.AF_UNIX) as line:
        line.connect(address)
        threading.Thread(target=server.listen, daemon=True).start()
        for block in blocks(line):
            server.show(block)
    sys.exit("the daemon has gone")


if __name__ == "__main__":
    main()
