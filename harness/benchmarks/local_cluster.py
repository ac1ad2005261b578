"""A Ray cluster on this machine's loopback, to try what a run does on many machines."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

PROGRAM = """
import sys
from ray.cluster_utils import Cluster

node = {"object_store_memory": 80 << 20}  # the least that Ray takes
cluster = Cluster(True, head_node_args={**node, "num_cpus": 0, "include_dashboard": False})
nodes = [cluster.add_node(num_cpus=1, **node) for _ in range(int(sys.argv[1]))]
cluster.wait_for_nodes()
print(cluster.address, flush=True)
for _ in sys.stdin:
    cluster.remove_node(nodes.pop(), allow_graceful=False)
    print("killed", flush=True)
cluster.shutdown()
"""
VARIABLES = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled"}
ENDING = 60.0
"""Seconds that its process has to end."""


class LocalCluster:
    """A cluster that runs: a head that computes nothing, and nodes of one core each.

    address: of its head. Raises RuntimeError where the process did not start one.
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        if not (address := self._answer()):
            raise RuntimeError("no Ray cluster could be started on this machine; is Ray installed?")
        self.address = address

    def kill_node(self) -> None:
        """Kill a node without grace, as a machine that is switched off."""
        assert self._process.stdin
        self._process.stdin.write("kill\n")
        self._process.stdin.flush()
        self._answer()

    def _answer(self) -> str:
        assert self._process.stdout
        return self._process.stdout.readline().strip()


@contextmanager
def local_cluster(nodes: int) -> Iterator[LocalCluster]:
    """Start a cluster in a process of its own, which ends with the context."""
    command, pipe = [sys.executable, "-c", PROGRAM, str(nodes)], subprocess.PIPE
    with subprocess.Popen(command, text=True, env=os.environ | VARIABLES, stdin=pipe, stdout=pipe) as process:
        try:
            yield LocalCluster(process)
        finally:
            try:
                process.communicate(timeout=ENDING)
            except subprocess.TimeoutExpired:
                process.kill()
