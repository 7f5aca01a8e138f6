"""Captures and lakes lie in places: folders, archives and stores, some of which fail or have strange names."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest
from pyarrow.fs import PyFileSystem

from analyzer.cli import main
from analyzer.errors import UnreadableError, UsageError
from analyzer.fleet import place as places
from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Place
from tests.fleet.lakes import candump, ingest, lake, rows


def test_what_is_no_lake_is_told(tmp_path):
    with pytest.raises(UnreadableError, match="is no lake"):
        Lake(Place(str(tmp_path)))
    with pytest.raises(UsageError, match="cannot commit"):
        Lake(Place("memory://lake"), make=True)


@pytest.mark.parametrize("url", ["memory://hall", "zip://::{}/hall.zip", "zip://m1::{}/hall.zip"])
def test_captures_lie_wherever_fsspec_reads(url, captures, clean, tmp_path):
    shutil.make_archive(str(tmp_path / "hall"), "zip", captures)
    there = Place(url.format(tmp_path))
    if url.startswith("memory"):
        there.fs.put(str(captures), "/hall", recursive=True)
    made = lake(tmp_path / "lake")
    pattern = "{date}/*" if "m1" in url else "{machine}/{date}/*"
    assert ingest(made, there, pattern=pattern).new == (2 if "m1" in url else 4)
    assert "m1" in url or rows(made) == clean
    assert ingest(made, there, pattern=pattern).new == 0


def test_what_a_store_gives_no_mark_for_is_looked_at_again(captures, tmp_path, monkeypatch):
    there, made = Place(str(captures)), lake(tmp_path / "lake")
    monkeypatch.setattr(places, "_MODIFIED", ())
    assert ingest(made, there).wanted == ingest(made, there).wanted == 5


def test_a_folder_that_may_not_be_listed_is_told_and_one_that_fails_now_and_then_is_asked_again(
    captures, tmp_path, monkeypatch
):
    there, fails = Place(str(captures)), [ConnectionError("cut off")]
    ls = type(there.fs).ls

    def closed(self, path, **named):
        if path.endswith("m0"):
            raise PermissionError(13, "Permission denied", path)
        if path.endswith("m1") and fails:
            raise fails.pop()
        return ls(self, path, **named)

    monkeypatch.setattr(places, "FIRST_WAIT", 0)
    with monkeypatch.context() as shut:
        shut.setattr(type(there.fs), "ls", closed)
        outcome = ingest(lake(tmp_path / "lake"), there)
    assert (outcome.new, fails) == (2, [])
    assert (str(captures / "m0"), "it may not be listed") in outcome.unread
    assert ingest(Lake(Place(str(tmp_path / "lake"))), there).new == 2


@pytest.mark.parametrize("call", ["glob", "ls"])
def test_a_lake_whose_store_has_gone_is_told_in_a_line(captures, tmp_path, cli, monkeypatch, call):
    made = lake(tmp_path / "lake")
    ingest(made, captures)

    real = getattr(type(made.place.fs), call)

    def gone(self, path, **named):
        if path.endswith("_delta_log"):
            raise ConnectionError("the store is gone")
        return real(self, path, **named)

    monkeypatch.setattr(type(made.place.fs), call, gone)
    monkeypatch.setattr(places, "FIRST_WAIT", 0)
    told = cli("ask", tmp_path / "lake", "select count(*) from captures", status=2).err
    assert (told.count("\n"), "cannot be read: the store is gone" in told) == (1, True)


def test_a_download_that_was_cut_is_fetched_again(captures, tmp_path, monkeypatch):
    there = Place("memory://cut")
    there.fs.put(str(captures / "m0"), "/cut/m0", recursive=True)
    fetch, cut = there.fs.get_file, []

    def cuts(key, target, **named):
        fetch(key, target, **named)
        if len(cut) < 2:
            cut.append(key)
            os.truncate(target, 10)

    monkeypatch.setattr(there.fs, "get_file", cuts)
    monkeypatch.setattr(places, "FIRST_WAIT", 0)
    assert (ingest(lake(tmp_path / "lake"), there).new, len(cut)) == (2, 2)


@pytest.mark.parametrize("url", ["sftp://host/lake", "zip://lake.zip", "memory://lake", "https://host/lake"])
@pytest.mark.parametrize("command", ["ingest", "ask", "fleet", "compact"])
def test_where_no_lake_can_be_is_told_in_a_line(command, url, tmp_path, cli):
    words = {"ingest": [str(tmp_path), "--to", url], "fleet": [url, "-o", str(tmp_path / "page.html")]}.get(command, [url])
    told = cli(command, *words, status=2).err
    assert (told.count("\n"), "cannot commit" in told) == (1, True)


def test_a_source_whose_package_is_missing_names_it(tmp_path, cli, monkeypatch):
    monkeypatch.setitem(sys.modules, "paramiko", None)
    monkeypatch.delitem(sys.modules, "fsspec.implementations.sftp", raising=False)
    # What a test before this one has loaded is kept in a registry.
    monkeypatch.delitem(sys.modules["fsspec.registry"]._registry, "sftp", raising=False)
    assert "paramiko" in cli("ingest", "sftp://host/captures", "--to", tmp_path / "lake", status=2).err


@pytest.mark.parametrize(
    ("given", "of_lake"),
    [
        (["--store", "key=source"], {"key": "source"}),
        (["--store", "key=source", "--lake-store", "key=lake", "--lake-store", "token=x=y"], {"key": "lake", "token": "x=y"}),
    ],
)
def test_a_lake_has_the_options_of_the_sources_or_its_own(monkeypatch, given, of_lake):
    asked = []

    def opened(place, **how):
        asked.append(place)
        raise UsageError("no lake is made here")

    def from_source(url, options):
        asked.append(Place(url, dict(options)))
        return asked[-1]

    monkeypatch.setattr("analyzer.fleet.cli.stores.Lake", opened)
    monkeypatch.setattr("analyzer.fleet.cli.ingest.place", from_source)
    assert main(["ingest", "s3://source/in", "--to", "s3://plant/lake", *given]) == 2
    assert [place.options for place in asked] == [{"key": "source"}, of_lake]


def test_a_store_that_fails_now_and_then_is_asked_again():
    waits, answers = [], iter([OSError("cut off"), OSError(104, "reset"), "fine"])

    def call():
        answer = next(answers)
        if isinstance(answer, OSError):
            raise answer
        return answer

    assert places.again(call, waits.append) == "fine"
    assert waits == [0.1, 0.2]
    with pytest.raises(OSError, match="EOFError: the server went"):
        places.again(lambda: (_ for _ in ()).throw(EOFError("the server went")), lambda seconds: None)
    with pytest.raises(OSError, match="No space"):
        places.again(lambda: (_ for _ in ()).throw(OSError(28, "No space")), waits.append)
    assert len(waits) == 2


@pytest.fixture
def waits(monkeypatch):
    """The seconds that were waited between attempts; in truth, none."""
    waited = []
    monkeypatch.setattr(places, "again", partial(places.again, wait=waited.append))
    return waited


@pytest.mark.parametrize("command", [["ask", "s3://plant/lake"], ["ingest", "s3://plant/hall", "--to", "lake"]])
@pytest.mark.parametrize("option", ["endpoint_url=http://127.0.0.1:{port}", ""])
def test_an_endpoint_at_which_no_server_answers_is_told_within_seconds(command, option, waits, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        # It is bound and does not listen: a connection is refused.
        port = free.getsockname()[1]
        if not option:
            monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}")
        words = ["--store", option.format(port=port)] if option else []
        assert main([*command, *words]) == 2
    said = capsys.readouterr().err
    assert f"endpoint_url='http://127.0.0.1:{port}': no such server answers there (Connection refused): check" in said
    assert sum(waits) < 1


def test_a_server_that_speaks_no_tls_is_no_endpoint_of_https(waits):
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(1) as pool:

        def answer():
            for _ in range(3):
                with server.accept()[0] as connection:
                    connection.recv(4096)
                    connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

        answered = pool.submit(answer)
        with pytest.raises(UsageError, match="check http or https"):
            Place("s3://plant/hall", {"endpoint_url": f"https://127.0.0.1:{server.getsockname()[1]}"})
        answered.result()


@pytest.mark.parametrize("url", ["minio:9000", "http://", "http://minio:99999", "nonsense"])
def test_what_is_no_endpoint_is_told(url):
    with pytest.raises(UsageError, match="expected a URL of a server"):
        Place("s3://plant/hall", {"endpoint_url": url})


@pytest.mark.parametrize("name", ["läke ü", "a#b?c", "{a,b}*", "日本 'x' & \"y\"; ~$HOME"])
def test_a_lake_may_have_a_strange_name(captures, clean, tmp_path, name, cli):
    made = lake(tmp_path / name / "lake")
    assert ingest(made, captures).new == 4
    assert rows(Lake(made.place)) == clean
    for number in range(2):
        (tmp_path / f"{number}.log").write_text(candump(40 + number))
        assert ingest(made, tmp_path / f"{number}.log").new == 1
    assert main(["compact", made.place.url, "--keep", "0"]) == 0
    assert cli("ask", made.place.url, "select count(*) from captures").out.split()[-1] == "7"


@pytest.mark.parametrize("name", ["a%41", "a\udcff", "a\nb", "[x]", "a|b", "a\\b", "a^b"])
def test_a_lake_whose_name_delta_lake_reads_otherwise_is_refused(tmp_path, name):
    with pytest.raises(UsageError, match="without %"):
        lake(tmp_path / name)


def test_arrow_reads_the_files_of_a_folder_itself(captures, tmp_path):
    """By a store of Python, Arrow waits for ever where a file fails in one thread while another begins to read."""
    made = lake(tmp_path / "lake")
    ingest(made, captures)
    datasets = [made.dataset(table) for table in made.tables()]
    assert len(datasets) > 5
    for dataset in datasets:
        assert not isinstance(dataset.filesystem, PyFileSystem)
        assert not isinstance(dataset.filesystem.base_fs, PyFileSystem)


def test_folders_may_lie_deeper_than_python_calls(captures, tmp_path, monkeypatch):
    place = tmp_path / "deep"
    place.mkdir()
    monkeypatch.chdir(place)
    for _ in range(sys.getrecursionlimit() + 50):
        os.mkdir("d")
        os.chdir("d")
    Path("deep.log").write_text("FA 01 31 2C\n")
    try:
        assert [found.name[-10:] for found in Place(str(place)).files()] == ["d/deep.log"]
        assert Place(str(place)).link_in([""]) == ""
        os.symlink(tmp_path, "out")
        assert Place(str(place)).link_in([""]).endswith("d/d/out")
    finally:
        # What shutil removes may not lie so deep either.
        subprocess.run(["rm", "-r", place], check=True)


def test_a_link_to_a_folder_is_told_as_one(captures, clean, tmp_path, capsys):
    (captures / "circle").symlink_to(".")
    assert main(["ingest", str(captures), "--to", str(tmp_path / "lake")]) == 2
    assert "circle: a link to a folder, which is not followed" in capsys.readouterr().err
