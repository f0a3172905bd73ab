"""A sweep on a Ray cluster of two nodes on one machine; one node is killed midway.

Run by ``tests/engines/ray.sh``, in an environment that has the extra ``ray``.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from sweep import FAST, PATIENCE, ROOT, SLOW, Sweep, temporary_folder, until

os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
LENGTHS = [1001, 1002, 21, 22]
"""``max_iterations`` of the jobs, two of which run at a time, on different nodes."""


def main() -> None:
    """Run the test, and end every process of Ray."""
    from ray.cluster_utils import Cluster

    began = time.monotonic()
    with temporary_folder() as place:
        paths = [str(ROOT), str(Path(__file__).parent)]
        os.environ["PYTHONPATH"] = os.pathsep.join(paths)  # of the workers
        sweep = Sweep(place, LENGTHS)
        os.environ["TRL_EXPLORE_WAIT"] = str(sweep.wait)
        cluster = Cluster(
            initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
        )
        try:
            run(sweep, cluster)
        finally:
            cluster.shutdown()
    print(f"passed: Ray, {time.monotonic() - began:.0f} s")


def run(sweep: Sweep, cluster) -> None:
    """A node dies: by default Ray repeats its job; without retries, the same command does."""
    words = ["hydra/launcher=ray", f"hydra.launcher.ray.init.address={cluster.address}"]
    assert attempt(sweep, cluster, *words) == 0, sweep.said()
    sweep.check_files()

    sweep.cluster = sweep.place / "once" / "debug"
    once = [*words, "hydra.launcher.ray.remote.max_retries=0"]
    assert attempt(sweep, cluster, *once) == 1, sweep.said()
    assert "1 of 4 jobs failed" in sweep.said(), sweep.said()
    assert "Ray ended the job (" in sweep.said(), sweep.said()
    assert sweep.start(*once).wait(PATIENCE) == 0, sweep.said()
    sweep.check_files()


def attempt(sweep: Sweep, cluster, *words: str) -> int:
    """The status of the command when the second node dies midway."""
    node = cluster.add_node(num_cpus=1, node_ip_address="127.0.0.2")
    cluster.wait_for_nodes()
    sweep.pace(SLOW)
    command = sweep.start(*words)
    until("both nodes train", lambda: all(map(sweep.has_begun, LENGTHS[:2])), command)
    cluster.remove_node(node, allow_graceful=False)
    sweep.pace(FAST)
    return command.wait(PATIENCE)


if __name__ == "__main__":
    main()
