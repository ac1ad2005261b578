"""How long policies live on the pendulum, of every method and control, where episodes end as the environment
ends them (`native`) and where the end is a state that is paid like any other (`absorbing`): signs.png beside
this file, of the two runs.

From the root:

    for p in native absorbing; do irl-bench run --methods all,shaped_thesis,airl,dagger --envs pendulum \\
        --budget quick --seeds 1 --protocol $p --record none --out results/reference/signs/$p; done
    python results/reference/signs/figure.py
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from harness.records import REFERENCE, Row
from harness.report.figures import BLUE, ORANGE, as_file, styled
from harness.store.opening import open_to_verify

HERE = Path(__file__).parent
HORIZON = 1000
COLOURS = {"native": ORANGE, "absorbing": BLUE}
POLICIES = {"pi_star": "π*", "pi_R": "π_R"}


def rows_of(run: Path) -> list[Row]:
    with open_to_verify(run) as opened:
        results, damaged = opened.load()
    assert not damaged
    rows = (row for result in results.values() for row in result.rows)
    return [row for row in rows if row.status == "ok" and row.method != REFERENCE]


def figure(rows: Mapping[str, Sequence[Row]]) -> Figure:
    """A panel a policy, a line a method, a dot a seed. rows: those of each protocol."""
    methods = list(dict.fromkeys(row.method for its in rows.values() for row in its))
    drawn = Figure(figsize=(9, 0.28 * len(methods) + 1.2), layout="constrained")
    for place, (policy, label) in enumerate(POLICIES.items()):
        axes = drawn.add_subplot(1, 2, place + 1)
        for protocol, colour in COLOURS.items():
            its = [row for row in rows[protocol] if row.policy == policy]
            shift = 0.15 if protocol == "native" else -0.15
            heights = [methods.index(row.method) + shift for row in its]
            lengths = [row.length_mean for row in its]
            axes.scatter(lengths, heights, s=18, color=colour, label=protocol, zorder=3)
        axes.set_yticks(range(len(methods)), methods if place == 0 else [""] * len(methods))
        axes.set_ylim(len(methods) - 0.4, -0.6)
        axes.set_xlim(0, HORIZON * 1.03)
        axes.grid(axis="y", linewidth=0.5)
        axes.set_xlabel(f"steps that {label} lives, of {HORIZON}")
    handles, labels = axes.get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    return drawn


if __name__ == "__main__":
    found = {protocol: rows_of(HERE / protocol) for protocol in COLOURS}
    with styled():
        (HERE / "signs.png").write_bytes(as_file(figure(found), "png"))
