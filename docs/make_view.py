"""Make the pictures of what people look at: the terminal view, and the page of an emulated drive as Chromium draws it.

python docs/make_view.py           view.svg, view-plot.svg, report.png
"""

from __future__ import annotations

import argparse
import asyncio
import io
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from analyzer import dialects  # noqa: E402
from analyzer.cli import main  # noqa: E402
from analyzer.cli.reading import add_reading_arguments, open_reading  # noqa: E402
from analyzer.encoder import build  # noqa: E402
from analyzer.pipeline import Pipeline  # noqa: E402
from analyzer.port import Options  # noqa: E402
from analyzer.records import Chunk  # noqa: E402
from analyzer.sinks.mcap_log import McapLog  # noqa: E402
from analyzer.view.app import ViewApp  # noqa: E402
from analyzer.view.capture import CaptureSource  # noqa: E402
from conformance.drives.make import make, parse  # noqa: E402
from conformance.drives.serial_bus import SerialBus  # noqa: E402

SECOND = 1_000_000_000
START = 1_772_442_000 * SECOND
BAUD = 38400
DIALECT = dialects.get("mks-rs485")
#: Second -> what the host asks for then.
ORDERS = {
    0.0: ("enable", {"enabled": 1}),
    1.0: ("run_speed", {"direction": 0, "speed": 240, "acceleration": 180}),
    4.0: ("run_speed", {"direction": 1, "speed": 150, "acceleration": 150}),
    7.0: ("stop_speed", {"acceleration": 200}),
}


def session() -> Iterator[Chunk]:
    """Yield what is on the wire while a drive is moved and asked for its speed and position fifty times a second."""
    bus = SerialBus([make(parse(f"mks-rs485@1,work_mode=sr_vfoc,baud={BAUD}"))], name="left", speed=BAUD)
    orders = sorted(ORDERS.items())
    for turn in range(450):
        now_s = turn * 0.02
        bus.run_until(int(now_s * SECOND))
        command, values = orders.pop(0)[1] if orders and orders[0][0] <= now_s else ("", {})
        command = command or ("read_speed" if turn % 2 else "read_encoder_carry")
        gone_ns = bus.send(data := build(DIALECT, command, 1, values))
        yield Chunk(START + gone_ns, "left", data)
        while (reply := bus.receive(15_000_000)) is not None:
            yield Chunk(START + (reply.t_ns or 0), "left", reply.data)


def recorded(path: Path) -> Path:
    """Write the session as a log."""
    with path.open("wb") as stream:
        log = McapLog(stream, byte_ns=10 * SECOND // BAUD)
        Pipeline([DIALECT], (log,), Options(byte_ns=10 * SECOND // BAUD)).run(session())
        log.finish({"source": "an emulated drive", "time_source": "virtual time"})
    return path


async def picture(path: Path, keys: tuple[str, ...], size: tuple[int, int]) -> str:
    """Return the view of a capture after some keys, as SVG."""
    parser = argparse.ArgumentParser()
    add_reading_arguments(parser)
    source = CaptureSource(open_reading(str(path), parser.parse_args(["--baud", str(BAUD)])))
    try:
        app = ViewApp(source)
        async with app.run_test(size=size) as pilot:
            while not source.done:
                await pilot.pause(0.05)
            for key in keys:
                await pilot.press(key)
            for _ in range(5):
                await pilot.pause(0.1)
            return str(app.export_screenshot(title=f"servotap view {path.name}"))
    finally:
        source.close()


def page(log: Path) -> bytes:
    """Return the top of the page of a log as PNG, of few colours so that it is small."""
    from PIL import Image

    made, shot = log.with_suffix(".html"), log.with_suffix(".png")
    main(["report", str(log), "-o", str(made)])
    words = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={log.parent / 'home'}"]
    words += ["--disable-background-networking", "--disable-sync", "--no-first-run", "--virtual-time-budget=3000"]
    words += ["--blink-settings=preferredColorScheme=1", "--window-size=1120,1130", f"--screenshot={shot}"]
    subprocess.run(["chromium", *words, made.as_uri()], check=True, capture_output=True)
    out = io.BytesIO()
    Image.open(shot).convert("RGB").quantize(48, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
    return out.getvalue()


def make_pictures() -> None:
    """Make the pictures."""
    with tempfile.TemporaryDirectory() as folder:
        log = recorded(Path(folder) / "axis.mcap")
        pictures = {
            "view.svg": (ROOT / "captures" / "mks_rs485.log", ("e", "enter"), (100, 28)),
            "view-plot.svg": (log, ("4", "right", "shift+right"), (100, 24)),
        }
        for name, (path, keys, size) in pictures.items():
            (ROOT / "docs" / name).write_text(asyncio.run(picture(path, keys, size)), encoding="utf-8")
            print(f"docs/{name} written")
        (ROOT / "docs" / "report.png").write_bytes(page(log))
        print("docs/report.png written")


if __name__ == "__main__":
    make_pictures()
