"""Times the live web page's server: from a hand's message to the joint targets, with a scripted page.

python benchmarks/bench_live.py --seconds 60 --retargeter runs/allegro_right --json live.json

A page in another process sends a headset's joints and reads all poses; their time stamps are of this
machine's monotonic clock, so that a delay begins before the message is sent. `late` counts pauses of a loop
that could not keep real time.
"""

import asyncio
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import aiohttp
import msgspec
import numpy as np
from rich.table import Table
from side_by_side import parse, parser, write_json

from geort_drake.console import console, run_main
from geort_drake.people.formats.source import KEYPOINTS_OF_25
from geort_drake.people.play import synthesize_play

# Columns are the axes of a headset's space in H of a hand that points forward; the wrist is in front of it.
R_HS = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
P_SH = np.array([0.2, 1.2, -0.3])


def main(argv: Sequence[str] | None = None) -> int:
    options = parser(__doc__)
    options.add_argument("--retargeter", type=Path, help="checkpoint (default: the command's)")
    options.add_argument("--rate", type=float, default=72.0, help="hands a second")
    options.add_argument("--scenario-text", default="{}", help="YAML merged into the scenario")
    arguments = parse(options, argv)
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "geort_drake", "live", "--port", "0", "--no-open", "--json"]
        command += ["--scenario-text", arguments.scenario_text]
        if arguments.retargeter:
            command += ["--retargeter", str(arguments.retargeter.resolve())]
        began = time.monotonic()
        with subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as server:
            address = None
            while address is None:
                line = server.stderr.readline()
                if not line:
                    return server.wait()
                address = re.search(r"http://\S+", line)
            play = _play(address[0], server.pid, arguments.rate, arguments.seconds, began)
            moved, growth, frame_rate, cpu = asyncio.run(play)
            server.send_signal(signal.SIGINT)
            report = json.loads(server.communicate()[0])
    delay = report["latency_s"]["command"]
    results = {
        "to_first_motion_s": moved,
        "median_ms": 1e3 * delay["median"],
        "p99_ms": 1e3 * delay["p99"],
        "commands": delay["count"],
        "hands": report["glove"]["received"],
        "late": report["late"],
        "server_cpu_share": cpu,
        "frames_per_s": frame_rate,
        "memory_growth_mb": growth,
    }
    table = Table(title="live web page")
    for heading in ("", "value"):
        table.add_column(heading)
    for name, value in results.items():
        table.add_row(name, f"{value:.4g}")
    console.print(table)
    if arguments.json:
        write_json(arguments.json, title="live", results=results)
    return 0


async def _play(
    address: str, server: int, rate: float, seconds: float, began: float
) -> tuple[float, float, float, float]:
    """Plays hands to the server.

    Returns:
        Time from the command to the first motion, s; growth of the server's memory after the first quarter,
        MB; frames a second; and the server's share of one core after the first quarter.
    """
    base, key = address.split("/#")
    hands = synthesize_play(0, duration_s=60.0, rate_hz=rate).p_HK
    moved, frames, before = np.nan, 0, (np.nan, np.nan, np.nan)
    async with aiohttp.ClientSession() as session, session.ws_connect(f"{base}/ws?key={key}") as page:

        async def read() -> None:
            nonlocal moved, frames
            async for message in page:
                frames += message.type == aiohttp.WSMsgType.BINARY
                if message.type == aiohttp.WSMsgType.TEXT and np.isnan(moved):
                    if msgspec.json.decode(message.data).get("following"):
                        moved = time.monotonic() - began

        hello = {"type": "hello", "version": 1, "role": "operator", "device": "scripted", "side": "right"}
        await page.send_str(msgspec.json.encode(hello).decode())
        reader = asyncio.create_task(read())
        start, count = time.monotonic(), round(rate * seconds)
        joints = np.zeros((25, 3))
        for number in range(count):
            joints[KEYPOINTS_OF_25,] = hands[number % len(hands)] @ R_HS + P_SH
            hand = {"type": "headset", "t": time.monotonic(), "joints": joints.tolist()}
            await page.send_str(msgspec.json.encode(hand).decode())
            if number == 10:
                await page.send_str('{"type": "engage"}')
            if number == count // 4:
                before = (*_used(server), time.monotonic())
            await asyncio.sleep(start + (number + 1) / rate - time.monotonic())
        reader.cancel()
    (memory, cpu), now = _used(server), time.monotonic()
    return moved, memory - before[0], frames / (now - start), (cpu - before[1]) / (now - before[2])


def _used(process: int) -> tuple[float, float]:
    """Memory, MB, and processor time, s, of a process."""
    status = Path(f"/proc/{process}/status").read_text()
    times = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
    memory = int(re.search(r"VmRSS:\s+(\d+)", status)[1]) / 1024
    return memory, sum(map(int, times)) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    run_main(main)
