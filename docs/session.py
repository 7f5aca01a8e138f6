"""A session from end to end: look at a capture, move a drive, compare. Cells begin with `# %%`, as in VS Code and Jupytext."""

# %% What is in a capture
from pathlib import Path

import polars

import servotap

captures = Path(__file__).resolve().parents[1] / "captures"
capture = servotap.open(captures / "mks_rs485.log")
table = capture.to_polars()
print(table.group_by("command", "role").len().sort("len", descending=True).head(5))

# %% How quick the drive answers: the median in ms for each command. A move answers twice: that it begins, and its end.
replies = table.filter(polars.col("latency").is_not_null()).unique("request_sequence", keep="first", maintain_order=True)
print(replies.group_by("command").agg(polars.col("latency").median()).sort("latency", descending=True).head(5))

# %% What is wrong
for found in capture.findings:
    print(f"{found.severity}: {found.text} (section {found.section or '-'})")

# %% A ramp of an emulated drive, with a log of all that is sent and comes
with servotap.drive("mks-rs485@1,work_mode=sr_vfoc", allow={"motion", "unbounded"}, log="ramp.mcap", replace_log=True) as drive:
    drive.send("run_speed", direction="ccw", speed=600, acceleration=240)
    while drive.speed() < 600:
        drive.position()
    drive.wait(0.5)
    drive.send("stop_speed", acceleration=240, wait=True)
    print(f"it stands at {drive.position():.0f} degrees")

# %% Look at it
ramp = servotap.open("ramp.mcap")
print(ramp.to_polars(rate="5Hz", topics="state"))
axes = ramp.plot("speed", "position")
axes[0].figure.savefig("session.png")
