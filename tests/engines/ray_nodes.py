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
    """The same command without retries, repeated; then in a new folder with the default."""
    words = ["hydra/launcher=ray", f"hydra.launcher.ray.init.address={cluster.address}"]
    once = ["output_dir=cluster", "hydra.launcher.ray.remote.max_retries=0", *words]
    for attempt, more in enumerate((once, [*once], ["output_dir=again", *words])):
        if attempt == 2:
            sweep.cluster = sweep.place / "again" / "debug"
        log = f"{attempt}.log"
        node = None if attempt == 1 else cluster.add_node(num_cpus=1)
        cluster.wait_for_nodes()
        sweep.pace(FAST if attempt == 1 else SLOW)
        command = sweep.start(*more, log=log)
        if node is not None:
            until("both nodes train", lambda: all(map(sweep.has_begun, LENGTHS[:2])), command)
            cluster.remove_node(node, allow_graceful=False)
            sweep.pace(FAST)
        status = command.wait(PATIENCE)
        said = (sweep.place / log).read_text()
        assert status == (1 if attempt == 0 else 0), said
        if attempt == 0:
            assert said.count("1 of 4 jobs failed") == 1, said
            assert said.count("Ray ended the job") == 2, said  # also in the list at the end
        else:
            sweep.check_files()


if __name__ == "__main__":
    main()
