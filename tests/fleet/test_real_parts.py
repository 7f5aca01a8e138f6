"""Lakes on real parts: processes of Dask, a bucket on a server, commands."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys

import pytest

import servotap
from analyzer.cli import main
from analyzer.cli.signals import Interrupt
from analyzer.fleet import ingest as ingesting
from analyzer.fleet.ingest import Ingest, Outcome, Pattern, workers, works
from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Place
from tests.fleet.lakes import candump, hall, ingest, options, rows


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    return hall(tmp_path_factory.mktemp("hall"), 6)


@pytest.fixture
def bucket(monkeypatch):
    """A bucket on a server that refuses every fifth call."""
    pytest.importorskip("moto.server")
    import boto3

    for name, value in {"ACCESS_KEY_ID": "key", "SECRET_ACCESS_KEY": "secret", "DEFAULT_REGION": "us-east-1"}.items():
        monkeypatch.setenv(f"AWS_{name}", value)
    command = [sys.executable, "-m", "tests.fleet.flaky_bucket"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        url = f"http://127.0.0.1:{server.stdout.readline().strip()}"
        boto3.client("s3", endpoint_url=url).create_bucket(Bucket="plant")
        yield url
        server.kill()


def test_a_bucket_that_fails_one_call_in_five_brings_the_same_rows(bucket, captures, clean, capsys):
    given = {"endpoint_url": bucket}
    there = Place("s3://plant/captures", given)
    for path in sorted(each for each in captures.rglob("*") if each.is_file()):
        there.write(str(path.relative_to(captures)), path.read_bytes())
    made = Lake(Place("s3://plant/lake", given), make=True)
    assert ingest(made, there).new == 6
    assert rows(made) == clean
    assert ingest(made, there).new == 0
    assert main(["ask", "s3://plant/lake", "select count(*) n from states", "--store", f"endpoint_url={bucket}"]) == 0
    assert capsys.readouterr().out.split() == ["n", str(len(clean["states"]))]


def test_captures_of_a_server_are_fetched_by_sftp(captures, clean, tmp_path, cli):
    pytest.importorskip("paramiko")
    from tests.fleet import sftp_server

    made = str(tmp_path / "lake")
    with sftp_server.serving(captures.parent) as port:
        source = f"sftp://plant@127.0.0.1:{port}/{captures.name}"
        words = ["ingest", source, "--to", made, "--machine", "{machine}/{date}/*", "--workers", "1", "--json"]
        assert "Authentication failed" in cli(*words, "--store", "password=wrong", status=2).err
        asked = [*words, "--store", f"password={sftp_server.PASSWORD}"]
        told = json.loads(cli(*asked, status=2).out)
        assert (told["new"], [each["name"] for each in told["unread"]]) == (6, ["notes.txt"])
        # Nothing is fetched of what is known.
        told = json.loads(cli(*asked).out)
        assert (told["known"], told["bytes"]) == (7, 0)
        assert "does not exist" in cli("ingest", f"{source}/nowhere", *asked[2:], status=2).err
    assert rows(Lake(Place(made))) == clean


class Cluster:
    """A scheduler of Dask and its workers, each a process of its own."""

    def __init__(self, processes):
        self._processes = processes
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"

    def _start(self, *words):
        command = [sys.executable, "-m", "dask", *words, "--no-dashboard"]
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True)
        self._processes.callback(lambda: (process.kill(), process.wait()))
        return process

    def schedule(self):
        return self._start("scheduler", "--host", "127.0.0.1", "--port", str(self.port))

    def work(self, name="another"):
        return self._start("worker", self.address, "--nthreads", "1", "--no-nanny", "--name", name)


def dies_in_the_middle():
    """Have this worker kill itself in the middle of the next capture."""
    from analyzer.pipeline import Pipeline

    feed, left = Pipeline.feed, iter(range(20, -1, -1))

    def last(self, item):
        if not next(left):
            os.kill(os.getpid(), signal.SIGKILL)
        feed(self, item)

    Pipeline.feed = last


@pytest.fixture
def cluster():
    with contextlib.ExitStack() as processes:
        yield Cluster(processes)


@pytest.mark.parametrize(("victim", "huge"), [("worker", False), ("scheduler", False), ("worker", True), ("scheduler", True)])
def test_a_process_that_is_killed_costs_time_alone(victim, huge, cluster, captures, clean, tmp_path, monkeypatch):
    monkeypatch.setattr(ingesting, "TASK_FILES", 1)
    if huge:
        monkeypatch.setattr(ingesting, "HUGE", 1)
    made = Lake(Place(str(tmp_path / "lake")), make=True)
    outcome = Outcome()
    found = works([Place(str(captures))], made, Pattern("{machine}/{date}/*"), False, outcome)
    scheduler, worker = cluster.schedule(), cluster.work("victim")
    cluster.work()
    with workers(cluster.address, 2) as client:
        client.wait_for_workers(2)
        if victim == "worker":
            known = client.scheduler_info(n_workers=-1)["workers"]
            client.run(dies_in_the_middle, workers=[address for address, each in known.items() if each["name"] == "victim"])

        class Watching(Ingest):
            def ended(self, task, future):
                if victim == "scheduler" and scheduler.poll() is None:
                    scheduler.kill()
                    scheduler.wait()
                    cluster.schedule()
                    # The workers of the first one end with it.
                    cluster.work()
                return super().ended(task, future)

        Watching(made, options(), outcome, Interrupt()).run(client, found)
    assert {"scheduler": scheduler, "worker": worker}[victim].wait() == -signal.SIGKILL
    assert outcome.new == 6
    assert rows(made) == clean
    # A worker of the scheduler that was killed may write a range after its scan was forgotten: `compact` removes it later.
    if victim == "worker":
        assert made.place.glob("ranges/*") == []


def test_ctrl_c_commits_what_was_taken_and_ends(captures, clean, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(ingesting, "TASK_FILES", 1)
    ended, sizes = Ingest.ended, []

    def interrupted(self, task, future):
        more = ended(self, task, future)
        sizes.append(len(self._waiting))
        if len(sizes) == 2:
            signal.raise_signal(signal.SIGINT)
        return more

    made = str(tmp_path / "lake")
    words = ["ingest", str(captures), "--to", made, "--machine", "{machine}/{date}/*", "--workers", "1", "--json"]
    with monkeypatch.context() as once:
        once.setattr(Ingest, "ended", interrupted)
        assert main(words) == 130
    told = json.loads(capsys.readouterr().out)
    assert 0 < told["new"] < 6
    assert len(rows(Lake(Place(made)))["captures"]) == told["new"] + len(told["unread"])
    main(words)
    assert json.loads(capsys.readouterr().out)["new"] == 6 - told["new"]
    assert rows(Lake(Place(made))) == clean


def test_dasks_dashboard_is_named_where_bokeh_is(captures, tmp_path, capsys, monkeypatch):
    for there in (True, False):
        monkeypatch.setattr(ingesting, "find_spec", lambda name, there=there: there)
        main(["ingest", str(captures / "m0"), "--to", str(tmp_path / str(there)), "--workers", "1"])
        assert ("Dask's dashboard: http://127.0.0.1:" in capsys.readouterr().err) == there


def test_processes_of_dask_that_cannot_be_started_are_no_fault(captures, tmp_path, capsys, monkeypatch):
    def refused(**settings):
        raise RuntimeError("Nanny failed to start.")

    monkeypatch.setattr("distributed.LocalCluster", refused)
    assert main(["ingest", str(captures), "--to", str(tmp_path / "lake"), "--workers", "7"]) == 2
    assert "7 workers of Dask cannot be started: Nanny failed to start. Fewer need" in capsys.readouterr().err


def test_the_commands(captures, tmp_path, cli):
    made = str(tmp_path / "lake")
    asked = ["ingest", str(captures), "--to", made, "--machine", "{machine}/{date}/*", "--workers", "1", "--json"]
    told = json.loads(cli(*asked, status=2).out)
    assert (told["new"], told["known"], [each["name"] for each in told["unread"]]) == (6, 0, ["notes.txt"])
    assert json.loads(cli(*asked).out)["known"] == 7
    table = tmp_path / "speeds.csv"
    assert main(["ask", made, "select machine, count(*) n from captures group by 1 order by 1", "-o", str(table)]) == 0
    assert table.read_text().splitlines()[1:] == ['"m0",3', '"m1",3', ",1"]
    assert "did you mean states" in cli("ask", made, "select * from state", status=2).err
    assert "mks_can.read_speed_reply" in cli("ask", made).out
    assert main(["compact", made]) == 0
    page = tmp_path / "fleet.html"
    assert [main(["fleet", made, "-o", str(page)]) for _ in range(2)] == [0, 2]
    assert "Machines and drives" in page.read_text()
    opened = servotap.lake(made)
    assert opened.table("states").select("speed").collect().height == opened.sql("from states").num_rows > 0


def test_what_could_not_be_read_is_tried_again_by_the_command(tmp_path, capsys):
    folder, made = tmp_path / "in", tmp_path / "lake"
    folder.mkdir()
    (folder / "a.log").write_text(candump(1))
    # A frame among other bytes is recognised as nothing, until the user says what the file is.
    (folder / "b.dat").write_bytes(b"nothing of use\n" * 20 + bytes.fromhex("FA 01 32 2D"))
    asked = ["ingest", str(folder), "--to", str(made), "--workers", "1", "--json"]
    told = []
    for words, code in (([], 2), (["--format", "raw"], 0), (["--format", "raw", "--retry"], 0), (["--retry"], 0)):
        assert main([*asked, *words]) == code
        told.append(json.loads(capsys.readouterr().out))
    assert [(each["new"], each["known"], len(each["unread"])) for each in told] == [(1, 0, 1), (0, 2, 0), (1, 1, 0), (0, 2, 0)]
    found = rows(Lake(Place(str(made))))
    assert [row["status"] for row in found["captures"]] == ["decoded", "decoded"]
    assert len(found["mks_rs485.read_speed_request"]) == 1
