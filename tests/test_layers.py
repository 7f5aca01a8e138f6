"""Arrows run one way: the order of the design. That the analyzer never writes to a bus stands in test_passive.py."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

#: Lower layers first; a module imports only what stands before it (or beside it).
LAYERS = (
    ("analyzer.errors", "analyzer"),
    ("analyzer.layout",),
    ("analyzer.codec", "analyzer.values"),
    ("analyzer.link",),
    ("analyzer.catalogue",),
    ("analyzer.protocols",),
    ("analyzer.dialects", "analyzer.records"),
    ("analyzer.context",),
    ("analyzer.framer", "analyzer.decoder", "analyzer.encoder"),
    ("analyzer.findings",),
    ("analyzer.transactions", "analyzer.events"),
    ("analyzer.port",),
    ("analyzer.pipeline",),
    ("analyzer.detect",),
    ("analyzer.sources", "analyzer.sinks", "analyzer.reference", "analyzer.export"),
    ("analyzer.live",),
    ("analyzer.cli", "analyzer.view", "analyzer.__main__"),
)


def modules(package):
    return sorted((ROOT / package).rglob("*.py"))


def name_of(path):
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path):
    """Return what a module imports when it is loaded or run, type-checking blocks left out."""
    tree = ast.parse(path.read_text())
    guarded = {
        id(n)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        for n in ast.walk(node)
    }
    found = set()
    for node in ast.walk(tree):
        if id(node) in guarded:
            continue
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            found |= {f"{node.module}.{a.name}" for a in node.names if (ROOT / node.module.replace(".", "/")).is_dir()}
    return found


def layer(name):
    best = (-1, -1)
    for number, names in enumerate(LAYERS):
        for each in names:
            if (name == each or name.startswith(each + ".")) and len(each) > best[1]:
                best = (number, len(each))
    return best[0]


@pytest.mark.parametrize("path", modules("analyzer"), ids=name_of)
def test_imports_run_one_way(path):
    own = layer(name_of(path))
    assert own >= 0, f"{name_of(path)} stands in no layer"
    for imported in imports(path):
        if imported.split(".")[0] == "analyzer":
            assert layer(imported) <= own, f"{name_of(path)} imports {imported}, which stands above it"
        # The command line may look up help texts of added commands, by name and only if they are there.
        assert imported.split(".")[0] != "conformance" or name_of(path) == "analyzer.cli", imported


@pytest.mark.parametrize("path", [p for p in modules("conformance") if "drives" in p.relative_to(ROOT).parts], ids=name_of)
def test_drives_need_no_test_packages(path):
    assert not {i.split(".")[0] for i in imports(path)} & {"pytest", "hypothesis"}


@pytest.mark.parametrize("path", modules("analyzer") + modules("conformance"), ids=name_of)
def test_no_name_that_says_nothing(path):
    words = re.findall(r"(?:class|def)\s+(\w+)", path.read_text())
    bad = [w for w in words if re.search(r"packet|telegram|utils|manager|helper", w, re.IGNORECASE)]
    bad += [path.stem] if path.stem in ("utils", "helpers", "base", "common") else []
    assert not bad


def test_help_needs_nothing_heavy():
    code = "import sys; from analyzer.cli import main; main(['--help']); print(sorted(sys.modules), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "decode" in done.stdout
    packages = ("can", "rich", "textual", "foxglove", "mcap", "numpy", "serial", "msgspec", "fastcrc", "hypothesis")
    for heavy in (*packages, "analyzer.catalogue"):
        assert f"'{heavy}'" not in done.stderr, heavy
