"""A long recording is read in bounded memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

READ = """
import resource, sys
from stillcal.replay.formats.trace import open_trace

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

trace = open_trace(sys.argv[1])
chunks = trace.chunks()
rows = len(next(chunks).accelerometer)
base = peak()
rows += sum(len(chunk.accelerometer) for chunk in chunks)
print(rows, peak() - base)
"""


def test_a_file_of_60_mb_needs_less_than_20_mb_more_than_its_first_chunk(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    body = "".join(
        f"{{day}}{i:05d}.5,0.0123456789,-0.023456789,9.80{i % 1000:03d},0.001,0.002,0.003\n"
        for i in range(50_000)
    )
    with path.open("w") as file:
        file.write("t,ax,ay,az,gx,gy,gz\n")
        for day in range(1, 21):
            file.write(body.replace("{day}", str(day)))
    assert path.stat().st_size > 55e6
    result = subprocess.run(
        [sys.executable, "-c", READ, str(path)], check=False, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    rows, megabytes = result.stdout.split()
    assert int(rows) == 1_000_000
    assert float(megabytes) < 20
