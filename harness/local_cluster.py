"""A Ray cluster on this machine's loopback, to try what a run does on many machines:

    python -m harness.local_cluster NODES

A head that computes nothing and nodes of one core each, until standard input ends; each line there kills a
node without grace. Prints its address, and 'killed' for each node.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

STORE = 80 << 20
"""Bytes of each node's object store, the least that Ray takes."""
ENDING = 60.0
"""Seconds that it has to end."""


class LocalCluster:
    """One that runs. address: of its head. Raises RuntimeError where the process did not start one."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        if not (address := self._said()):
            raise RuntimeError("no Ray cluster could be started on this machine; is Ray installed?")
        self.address = address

    def kill_node(self) -> None:
        """Without grace, as a machine that is switched off."""
        assert self._process.stdin
        self._process.stdin.write("kill\n")
        self._process.stdin.flush()
        self._said()

    def _said(self) -> str:
        assert self._process.stdout
        return self._process.stdout.readline().strip()


@contextmanager
def local_cluster(nodes: int) -> Iterator[LocalCluster]:
    """In a process of its own, and gone with the context."""
    command = [sys.executable, "-m", "harness.local_cluster", str(nodes)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield LocalCluster(process)
        finally:
            assert process.stdin
            process.stdin.close()
            try:
                process.wait(ENDING)
            except subprocess.TimeoutExpired:
                process.kill()


def _serve(count: int) -> None:
    os.environ |= {
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
        "RAY_AUTH_MODE": "disabled",
    }
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
