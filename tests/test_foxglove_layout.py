"""The layout for Foxglove: every panel is placed once, has settings that Foxglove knows, and shows what a log holds."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from mcap.reader import make_reader

from tests import ROOT

LAYOUT = json.loads((ROOT / "docs" / "servotap.foxglove-layout.json").read_text())
PANELS = LAYOUT["configById"]
#: Kind of panel in a layout file -> its name in the SDK.
KINDS = {
    "Plot": "PlotConfig", "RosOut": "LogConfig", "RawMessages": "RawMessagesConfig", "Table": "TableConfig",
    "StateTransitions": "StateTransitionsConfig",
}  # fmt: skip


@pytest.fixture(scope="module")
def topics(tmp_path_factory):
    """Topics of a decoded capture, with the fields of their messages."""
    log = tmp_path_factory.mktemp("layout") / "log.mcap"
    command = [sys.executable, "-m", "analyzer", "decode", "captures/mks_rs485.log", "--baud", "38400", "-o", str(log)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=60)
    found: dict[str, set[str]] = {}
    with log.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            found.setdefault(channel.topic, set()).update(json.loads(message.data))
    return found


def placed(node):
    return [node] if isinstance(node, str) else placed(node["first"]) + placed(node["second"])


def test_every_panel_is_placed_once():
    assert sorted(placed(LAYOUT["layout"])) == sorted(PANELS)
    assert {"Plot", "RosOut", "RawMessages", "Table"} <= {name.split("!")[0] for name in PANELS}


@pytest.mark.parametrize("name", list(PANELS))
def test_foxglove_knows_the_settings(name):
    layouts = pytest.importorskip("foxglove.layouts", reason="foxglove-sdk is not installed (the extra `foxglove`)")
    known = set(getattr(layouts, KINDS[name.split("!")[0]])()._to_dict())
    assert set(PANELS[name]) - {"foxglovePanelTitle"} <= known
    paths = {"Plot": "PlotSeries", "StateTransitions": "StateTransitionsSeries"}.get(name.split("!")[0])
    for path in PANELS[name].get("paths", ()):
        assert set(path) <= set(getattr(layouts, str(paths))(value="")._to_dict())


@pytest.mark.parametrize("name", list(PANELS))
def test_what_it_shows_is_in_the_log(name, topics):
    panel = PANELS[name]
    for path in panel.get("paths", ()):
        topic, _, field = path["value"].rpartition(".")
        assert field in topics[topic], path["value"]
    for key in ("topicPath", "topicToRender"):
        assert panel.get(key, "/findings") in topics
