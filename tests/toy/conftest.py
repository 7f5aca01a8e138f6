from __future__ import annotations

from pathlib import Path

import pytest

from analyzer import dialects
from tests.plugin_site import installed, make_site

FILE = Path(__file__).with_name("dialect.py")


@pytest.fixture(scope="package")
def site(tmp_path_factory):
    """A folder with the toy as a package of its one file."""
    return make_site(tmp_path_factory.mktemp("site"), "toy_can", FILE.read_text(), "toy-can")


@pytest.fixture
def toy(site):
    """The dialect, found by its entry point while the test runs."""
    with installed(site):
        yield dialects.get("toy-can")
