"""Times the live web page: from a hand's message to the joint targets, and from a picture to its hand.

python benchmarks/bench_live.py --seconds 600 --json live.json
python benchmarks/bench_live.py --seconds 60 --film hand.mjpeg

A scripted page in another process sends a headset's joints and reads all poses; its time stamps are on this
machine's monotonic clock, so that delays include sending. It records, plays the guided motions, fits the map,
and resets every two minutes, so memory growth is that of sessions with everything on. The JSON file has 60
samples of memory and delay over time. With --film, a film of a hand made by `film_hand` of
tests/live_page.py, Chromium's camera plays it to the page instead. `late` counts pauses of a loop that could
not keep real time.
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
from geort_drake.people.formats import KEYPOINTS_OF_25
from geort_drake.people.synthetic.play import synthesize_play

# A headset's space S relative to H of a hand that points forward, and the wrist's position in S, m.
R_HS = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
P_SH = np.array([0.2, 1.2, -0.3])
# Command of the page → when it is sent, s.
COMMANDS = {"engage": 0.2, "record": 0.5}
EXTRA = {"record": {"keep": True}}
RESET_S = 120.0  # s between two resets; the page engages again after a second
SAMPLES = 60
# Collects the age of each picture when its hand is sent, ms, and counts drawings of the 3D view.
READ_PAGE = """
  const send = WebSocket.prototype.send;
  window.ages = [];
  WebSocket.prototype.send = function (text) {
    const { type, t } = JSON.parse(text);
    if (type === "camera") ages.push(performance.now() - 1000 * t);
    return send.call(this, text);
  };
  window.pictures = 0;
  const count = (context, name) => {
    const draw = context[name];
    context[name] = function (...values) {
      pictures += this.canvas.id === "view";
      return draw.apply(this, values);
    };
  };
  count(CanvasRenderingContext2D.prototype, "putImageData");
  count(WebGL2RenderingContext.prototype, "clear");
"""


def main(argv: Sequence[str] | None = None) -> int:
    options = parser(__doc__)
    options.add_argument("--retargeter", type=Path, help="map (default: the command's)")
    options.add_argument("--film", type=Path, help="Motion JPEG film of a hand for the page's camera")
    options.add_argument("--rate", type=float, default=72.0, help="hands per second")
    options.add_argument("--scenario-text", default="{}", help="YAML merged into the scenario")
    arguments = parse(options, argv)
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "geort_drake", "live", "--port", "0", "--no-open", "--json", "-"]
        command += ["--scenario-text", arguments.scenario_text]
        if arguments.retargeter:
            command += ["--retargeter", str(arguments.retargeter.resolve())]
        began = time.monotonic()
        log = Path(folder, "log")
        with (
            log.open("w") as errors,
            subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=errors, text=True) as server,
        ):
            while not (address := re.search(r"http://\S+", log.read_text())):
                if server.poll() is not None:
                    print(log.read_text())
                    return server.returncode
                time.sleep(0.01)
            if arguments.film:
                measured, samples = _film(address[0], arguments.film.resolve(), arguments.seconds), []
            else:
                play = _play(address[0], server.pid, arguments.rate, arguments.seconds, began)
                measured, samples = asyncio.run(play)
            server.send_signal(signal.SIGINT)
            report = json.loads(server.communicate()[0])
        recordings = sum(file.stat().st_size for file in Path(folder).rglob("*.npz"))
        sizes = {"log_kb": log.stat().st_size / 1e3, "recordings_mb": recordings / 1e6}
    delay = report["delay_s"]
    results = {
        "message_to_target_median_ms": 1e3 * delay["median"],
        "message_to_target_p99_ms": 1e3 * delay["p99"],
        "commands": delay["count"],
        "hands": report["glove"]["received"],
        "late": report["late"],
        **measured,
        **sizes,
    }
    table = Table(title="live web page")
    for heading in ("", "value"):
        table.add_column(heading)
    for name, value in results.items():
        table.add_row(name, f"{value:.4g}")
    console.print(table)
    if arguments.json:
        write_json(arguments.json, title="live", results=results, samples=samples)
    return 0


def _film(address: str, film: Path, seconds: float) -> dict[str, float]:
    """Lets the page follow a film.

    Returns:
        Time from a picture to its hand, ms, and hands and drawn views per second.
    """
    from playwright.sync_api import sync_playwright

    camera = ("--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream")
    camera += (f"--use-file-for-fake-video-capture={film}",)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=camera)
        page = browser.new_page()
        page.add_init_script(READ_PAGE)
        page.goto(address)
        page.wait_for_selector("body[data-state=tracking]", timeout=60_000)
        page.keyboard.press(" ")
        page.wait_for_selector("body[data-state=engaged]", timeout=60_000)
        page.evaluate("ages.length = pictures = 0")
        began = time.monotonic()
        page.wait_for_timeout(1e3 * seconds)
        (ages, pictures), took = page.evaluate("[ages, pictures]"), time.monotonic() - began
        browser.close()
    return {
        "picture_to_hand_median_ms": float(np.median(ages)),
        "picture_to_hand_p99_ms": float(np.quantile(ages, 0.99)),
        "hands_per_s": len(ages) / took,
        "views_per_s": pictures / took,
    }


async def _play(
    address: str, server: int, rate: float, seconds: float, began: float
) -> tuple[dict[str, float], list[dict[str, float]]]:
    """Sends hands to the server, with everything on.

    Returns:
        Figures: time from the command to the first motion, s; frames per second; and after the first quarter,
        growth of the server's memory, MB, and its share of one core. And samples over time: time, s; memory,
        MB; median and 99th percentile of the newest 300 delays, ms.
    """
    base, key = address.split("/#")
    hands = synthesize_play(0, duration_s=60.0, rate_hz=rate).p_HK
    moved, frames, before = np.nan, 0, (np.nan, np.nan, np.nan)
    state: dict = {}
    samples: list[dict[str, float]] = []
    async with aiohttp.ClientSession() as session, session.ws_connect(f"{base}/ws?key={key}") as page:

        async def read() -> None:
            nonlocal moved, frames, state
            async for message in page:
                frames += message.type == aiohttp.WSMsgType.BINARY
                if message.type == aiohttp.WSMsgType.TEXT:
                    state = msgspec.json.decode(message.data)
                    if np.isnan(moved) and state.get("following"):
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
            for kind, second in COMMANDS.items():
                if number == round(rate * second):
                    await page.send_str(msgspec.json.encode({"type": kind, **EXTRA.get(kind, {})}).decode())
            for kind, second in (("reset", 0.0), ("engage", 1.0)):
                if number > rate * RESET_S / 2 and number % round(rate * RESET_S) == round(rate * second):
                    await page.send_str(msgspec.json.encode({"type": kind}).decode())
            if number % max(count // SAMPLES, 1) == 0 and (delay := state.get("delay", {})).get("count"):
                samples.append(
                    {
                        "s": time.monotonic() - start,
                        "memory_mb": _used(server)[0],
                        "median_ms": 1e3 * delay["median"],
                        "p99_ms": 1e3 * delay["p99"],
                    }
                )
            if number == count // 4:
                before = (*_used(server), time.monotonic())
            await asyncio.sleep(start + (number + 1) / rate - time.monotonic())
        reader.cancel()
    (memory, cpu), now = _used(server), time.monotonic()
    measured = {
        "to_first_motion_s": moved,
        "frames_per_s": frames / (now - start),
        "server_cpu_share": (cpu - before[1]) / (now - before[2]),
        "memory_growth_mb": memory - before[0],
    }
    return measured, samples


def _used(process: int) -> tuple[float, float]:
    """Returns memory, MB, and processor time, s, of a process."""
    status = Path(f"/proc/{process}/status").read_text()
    times = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
    memory = int(re.search(r"VmRSS:\s+(\d+)", status)[1]) / 1024
    return memory, sum(map(int, times)) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    run_main(main)
