"""A sweep on Slurm: jobs are cancelled or reach their time limit; the same command ends the rest.

    python tests/engines/slurm.py

Starts a Slurm of one node in a temporary folder, without an accounting database, and ends it. Needs
root, Debian's packages slurm-wlm and munge (installed if missing), and the extra ``submitit``.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from sweep import FAST, PATIENCE, SLOW, Sweep, skip, temporary_folder, until

CONF = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthInfo=socket={place}/munge.socket,cred_expire=5
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
StateSaveLocation={place}/state
SlurmdSpoolDir={place}/spool
SlurmctldPidFile={place}/slurmctld.pid
SlurmdPidFile={place}/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/affinity
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
MpiDefault=none
SlurmdParameters=config_overrides
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory=4000 State=UNKNOWN
PartitionName=all Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""
SHORT, CANCELLED, LIMITED, WAITING = 21, 1001, 1002, 22
"""``max_iterations`` of the four jobs, two of which run at a time."""
MINUTES = 9
"""The time limit of the jobs. submitit takes any end within ten minutes for the time limit."""


def install() -> None:
    """Install what is missing, or skip."""
    if os.geteuid() != 0:
        skip("the daemons of Slurm need root")
    if importlib.util.find_spec("submitit") is None:
        skip("submitit is not installed: pip install '.[submitit]'")
    if all(map(shutil.which, ("slurmctld", "slurmd", "munged", "sbatch"))):
        return
    if not shutil.which("apt-get"):
        skip("Debian's packages slurm-wlm and munge are not installed")
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    apt = ["apt-get", "install", "-y", "-qq", "--no-install-recommends", "slurm-wlm", "munge"]
    for command in (["apt-get", "update", "-qq"], apt):
        if subprocess.run(command, env=environment, stdout=subprocess.DEVNULL).returncode:
            skip("Debian's packages slurm-wlm and munge cannot be installed")


def free_ports() -> list[int]:
    """Two ports that no program uses."""
    with socket.socket() as one, socket.socket() as two:
        for made in (one, two):
            made.bind(("127.0.0.1", 0))
        return [made.getsockname()[1] for made in (one, two)]


def start_cluster(place: Path, stack: ExitStack) -> None:
    """Start Slurm with all its files in ``place``; the stack ends it."""
    for name in ("state", "spool"):
        (place / name).mkdir()
    key = place / "munge.key"
    key.write_bytes(os.urandom(1024))
    key.chmod(0o600)
    conf = place / "slurm.conf"
    host = socket.gethostname().split(".")[0]
    conf.write_text(CONF.format(place=place, host=host, ports=free_ports(), cpus=os.cpu_count()))
    os.environ["SLURM_CONF"] = str(conf)
    munged = [
        "munged", "--foreground", "--force", f"--key-file={key}", f"--socket={place}/munge.socket",
        f"--pid-file={place}/munged.pid", f"--seed-file={place}/seed",
    ]  # fmt: skip
    for command in (munged, ["slurmctld", "-D", "-c"], ["slurmd", "-D"]):
        log = stack.enter_context((place / f"{command[0]}.log").open("wb"))
        process = subprocess.Popen(command, stdout=log, stderr=log)
        stack.callback(process.wait)
        stack.callback(process.terminate)
    stack.callback(until, "Slurm has no job", lambda: not slurm("squeue", "-h"))
    stack.callback(slurm, "scancel", "--user=root")
    until("the node is idle", lambda: "idle" in slurm("sinfo", "-h"))


def slurm(*command: str) -> str:
    """What a command of Slurm prints."""
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def number(sweep: Sweep, length: int, state: str = "R,PD,S") -> str:
    """Slurm's number of a job of the running sweep; empty if it is in none of the states."""
    place = sweep.lengths.index(length)
    listed = slurm("squeue", "-h", "-r", "-o", "%i", "-t", state).split()
    return next((name for name in listed if name.endswith(f"_{place}")), "")


def end_soon(job: str) -> None:
    """Move the time limit of a running job to within the next two minutes."""
    spent = slurm("squeue", "-h", "-o", "%M", "-j", job).split(":")
    slurm("scontrol", "update", f"JobId={job}", f"TimeLimit={int(spent[-2]) + 2}")


def main() -> None:
    """Run the test."""
    install()
    began = time.monotonic()
    with ExitStack() as stack:
        place = stack.enter_context(temporary_folder())
        start_cluster(place, stack)
        run(place)
    print(f"passed: Slurm, {time.monotonic() - began:.0f} s")


def run(place: Path) -> None:
    """Three times the same command; the last one finishes the sweep."""
    sweep = Sweep(place, [SHORT, CANCELLED, LIMITED, WAITING])
    words = [
        "hydra/launcher=submitit_slurm", "hydra.launcher.mem_gb=1",
        f"hydra.launcher.timeout_min={MINUTES}", "hydra.launcher.signal_delay_s=5",
    ]  # fmt: skip

    sweep.pace(SLOW)
    command = sweep.start(*words)
    until("both long jobs train", lambda: all(map(sweep.has_begun, (CANCELLED, LIMITED))), command)
    slurm("scontrol", "hold", number(sweep, WAITING, "PD"))
    slurm("scancel", number(sweep, CANCELLED))
    end_soon(limited := number(sweep, LIMITED))
    until("Slurm has requeued the job", lambda: number(sweep, LIMITED, "PD") == limited, command)
    slurm("scancel", number(sweep, WAITING))
    sweep.pace(FAST)
    assert command.wait(PATIENCE) == 1, "two jobs were cancelled"
    said = sweep.said()
    assert said.count("CANCELLED); run the same command to resume") == 4, said  # listed twice
    assert "2 of 4 jobs failed" in said, said
    assert sweep.is_done(LIMITED), "the requeued job did not end"
    assert sweep.has_begun(CANCELLED), "the cancelled job has lost its checkpoint"

    sweep.pace(SLOW)
    command = sweep.start(*words, "hydra.launcher.max_num_timeout=0")
    until("the cancelled job trains", lambda: number(sweep, CANCELLED, "R"), command)
    end_soon(number(sweep, CANCELLED))
    assert command.wait(PATIENCE) == 1, "one job reached its time limit"
    said = sweep.said()
    assert "timed-out too many times" in said, said
    assert "1 of 4 jobs failed" in said, said

    sweep.pace(FAST)
    command = sweep.start(*words)
    assert command.wait(PATIENCE) == 0, sweep.said()
    sweep.check_files()


if __name__ == "__main__":
    main()
