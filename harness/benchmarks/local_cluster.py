"""A Ray cluster on this machine's loopback, to try what a run does on many machines.

It is started by `python -m harness.benchmarks.local_cluster NODES`.
It has a head that computes nothing and nodes of one core each, prints its address, and lives until standard
input ends. Each line there kills a node without grace.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

STORE = 80 << 20
"""Bytes of each node's object store, the least that Ray takes."""
ENDING = 60.0
"""Seconds that its process has to end."""


@dataclass(frozen=True)
class LocalCluster:
    """A running cluster. `address`: its head's. `process`: its own."""

    address: str
    process: subprocess.Popen[str]

    def kill_node(self) -> None:
        """Kill a node without grace, as a machine that is switched off."""
        assert self.process.stdin
        assert self.process.stdout
        print("kill", file=self.process.stdin, flush=True)
        self.process.stdout.readline()


@contextmanager
def local_cluster(nodes: int) -> Iterator[LocalCluster]:
    """Start a cluster, which ends with the context. Raises RuntimeError where it does not start."""
    command = [sys.executable, "-m", __name__, str(nodes)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin
        assert process.stdout
        try:
            if not (address := process.stdout.readline().strip()):
                raise RuntimeError("no Ray cluster could be started on this machine; is Ray installed?")
            yield LocalCluster(address, process)
        finally:
            process.stdin.close()
            try:
                process.wait(ENDING)
            except subprocess.TimeoutExpired:
                process.kill()


def _serve(count: int) -> None:
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
    os.environ["RAY_AUTH_MODE"] = "disabled"
    from ray.cluster_utils import Cluster  # which reads them

    head = {"num_cpus": 0, "include_dashboard": False, "object_store_memory": STORE}
    cluster: Any = Cluster(initialize_head=True, head_node_args=head)
    nodes = [cluster.add_node(num_cpus=1, object_store_memory=STORE) for _ in range(count)]
    cluster.wait_for_nodes()
    print(cluster.address, flush=True)
    for _ in sys.stdin:
        cluster.remove_node(nodes.pop(), allow_graceful=False)
        print("killed", flush=True)
    cluster.shutdown()


if __name__ == "__main__":
    _serve(int(sys.argv[1]))
