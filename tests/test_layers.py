"""Arrows run one way: the order of the design. That the analyzer never writes to a bus stands in test_passive.py."""

from __future__ import annotations

import ast
import re
import subprocess
import sys

from tests import ROOT

#: Lower layers first; a module imports only what stands before it (or beside it).
LAYERS = (
    ("analyzer.errors", "analyzer"),
    ("analyzer.layout",),
    ("analyzer.codec", "analyzer.values"),
    ("analyzer.plugins", "analyzer.system"),
    ("analyzer.link",),
    ("analyzer.catalogue",),
    ("analyzer.protocols",),
    ("analyzer.dialects", "analyzer.records"),
    ("analyzer.context", "analyzer.foreign", "analyzer.junk", "analyzer.slicers"),
    ("analyzer.framer", "analyzer.decoder", "analyzer.encoder"),
    ("analyzer.findings",),
    ("analyzer.transactions", "analyzer.events"),
    ("analyzer.port",),
    ("analyzer.columns",),
    ("analyzer.entries", "analyzer.pipeline"),
    ("analyzer.detect",),
    ("analyzer.logic",),
    ("analyzer.diagnosis",),
    ("analyzer.sources", "analyzer.sinks", "analyzer.reference", "analyzer.export", "analyzer.page", "analyzer.table"),
    ("analyzer.report",),
    ("analyzer.devices",),
    ("analyzer.live",),
    ("analyzer.cli", "analyzer.view", "analyzer.__main__"),
    ("analyzer.fleet",),
    ("conformance.claim", "conformance"),
    ("conformance.drives",),
    ("conformance.bus",),
    ("conformance.gate",),
    ("conformance.talk",),
    ("conformance.motion",),
    ("conformance.model",),
    ("conformance.safety",),
    ("conformance.claims",),
    ("conformance.suite",),
    ("conformance.tools", "conformance.report"),
    ("conformance.serve",),
    ("conformance.tap",),
    ("conformance.cli",),
    ("servotap",),
    ("conformance.pytest_plugin",),
)


def modules(package):
    return sorted((ROOT / package).rglob("*.py"))


def name_of(path):
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


PACKAGES = ("analyzer", "conformance", "servotap")
MODULES = {name_of(path): path for package in PACKAGES for path in modules(package)}


def room(name):
    """Return the part of the design that a module belongs to; the public package is one."""
    return "servotap" if name.startswith("servotap.") else ".".join(name.split(".")[:2])


def imported_by(tree):
    """Return the names of the modules that a piece of a module imports, those for type checking included."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            named = {f"{node.module}.{a.name}" for a in node.names}
            found |= {each if each in MODULES else node.module for each in named}
    return found


def imports(path):
    return imported_by(ast.parse(path.read_text()))


def loaded(path):
    """Return what a module imports outside of functions."""
    tree = ast.parse(path.read_text())
    functions = [node for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))]
    for function in functions:
        function.body = []
    return imported_by(tree)


def layer(name):
    """Return the number of a module's layer, -1 for none."""
    for number, names in enumerate(LAYERS):
        if name in names or room(name) in names:
            return number
    return -1


def test_every_module_stands_in_a_layer():
    assert [name for name in MODULES if layer(name) < 0] == []


# One test over all modules, as those below: each for itself costs more than what it looks at.
def test_imports_run_one_way():
    own = [(name, each) for name, path in MODULES.items() for each in imports(path) if each.split(".")[0] in PACKAGES]
    assert len(own) > len(MODULES)
    # The command line may look up help texts of added commands, by name and only if they are there.
    upwards = [pair for pair in own if layer(pair[1]) > layer(pair[0]) and pair != ("analyzer.cli", "conformance.cli")]
    assert upwards == []


def circles(edges):
    """Return the sets of modules that reach each other (Tarjan)."""
    index, low, stack, found = {}, {}, [], []

    def visit(name):
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in sorted(edges[name]):
            if other not in index:
                visit(other)
            if other in stack:
                low[name] = min(low[name], low[other])
        if low[name] == index[name]:
            at = stack.index(name)
            part = set(stack[at:])
            del stack[at:]
            if len(part) > 1:
                found.append(part)

    for name in sorted(edges):
        if name not in index:
            visit(name)
    return found


def test_a_circle_is_found():
    edges = {"a": {"b"}, "b": {"c", "d"}, "c": {"a"}, "d": {"e"}, "e": {"f"}, "f": {"e"}, "g": {"a"}}
    assert circles(edges) == [{"e", "f"}, {"a", "b", "c"}]


def test_no_modules_import_each_other_in_a_circle():
    edges = {name: (loaded(path) & MODULES.keys()) - {name} for name, path in MODULES.items()}
    assert not circles(edges)


def test_drives_need_no_test_packages():
    drives = {name: path for name, path in MODULES.items() if name.startswith("conformance.drives")}
    assert len(drives) > 20
    assert [n for n, path in drives.items() if {i.split(".")[0] for i in imports(path)} & {"pytest", "hypothesis"}] == []


def test_no_name_that_says_nothing():
    words = [(name, w) for name, path in MODULES.items() for w in re.findall(r"(?:class|def)\s+(\w+)", path.read_text())]
    assert len(words) > 1000
    assert [each for each in words if re.search(r"packet|telegram|utils|manager|helper", each[1], re.IGNORECASE)] == []
    assert [name for name, path in MODULES.items() if path.stem in ("utils", "helpers", "base", "common")] == []


def test_the_page_for_those_who_add_names_each_folder():
    named = (ROOT / "docs" / "adding.md").read_text()
    folders = {path.parent.relative_to(ROOT).parts[:2][-1] for path in MODULES.values()}
    assert [folder for folder in sorted(folders) if f"{folder}/" not in named] == []


def test_help_needs_nothing_heavy():
    code = "import sys; from analyzer.cli import main; main(['--help']); print(sorted(sys.modules), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "decode" in done.stdout
    packages = ("can", "rich", "textual", "foxglove", "mcap", "numpy", "serial", "msgspec", "fastcrc", "hypothesis", "jinja2")
    for heavy in (*packages, "analyzer.catalogue"):
        assert f"'{heavy}'" not in done.stderr, heavy


def test_a_format_is_found_without_numpy():
    # Bytes without a certain format: each format is asked.
    code = "import sys; from analyzer.sources import open_source; open_source(sys.argv[1]); print('numpy' in sys.modules)"
    for name in ("mks_rs485.log", "mks_rs485.bin"):
        words = [sys.executable, "-c", code, f"captures/{name}"]
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
        assert done.stdout == "False\n", name
