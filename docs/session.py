"""A session from end to end: look at a capture, move a drive, compare. Cells begin with `# %%`, as in VS Code and Jupytext."""

# %% What is in a capture
from pathlib import Path

import polars

import servotap

captures = Path(__file__).resolve().parents[1] / "captures"
capture = servotap.open(captures / "mks_rs485.log")
table = capture.to_polars()
print(table.group_by("command", "role").len().sort("len", descending=True).head(5))

# %% How quick the drive answers: the median in ms for each command
replies = table.filter(polars.col("latency").is_not_null())
print(replies.group_by("command").agg(polars.col("latency").median()).sort("latency", descending=True).head(5))

# %% What is wrong
for found in capture.findings:
    print(f"{found.severity}: {found.text} (section {found.section or '-'})")

# %% A ramp of an emulated drive: 20 readings of its speed
times, speeds = [], []
with servotap.drive("mks-rs485@1,work_mode=sr_vfoc", allow={"motion", "unbounded"}) as drive:
    drive.send("run_speed", direction="ccw", speed=600, acceleration=240)
    for step in range(20):
        times.append(0.05 * step)
        speeds.append(drive.speed())
        drive.wait(0.05)
    drive.send("stop_speed", acceleration=240, wait=True)
print(f"from {speeds[0]:.0f} to {max(speeds):.0f} rpm, and back to rest")

# %% Plot both
axes = capture.plot("speed")
axes[0].plot(times, speeds, marker=".", label="emulated ramp")
axes[0].legend()
axes[0].figure.savefig("session.png")
