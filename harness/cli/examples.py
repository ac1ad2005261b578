"""Two examples for the end of each command's help, by the command as it is typed."""

from __future__ import annotations

EXAMPLES = {
    "irl-bench": (
        "irl-bench run --methods shaped,bc --envs highway",
        "irl-bench list",
    ),
    "irl-bench run": (
        "irl-bench run --methods all --envs swingup --seeds 5 --demos 5 --transfer flipped",
        "irl-bench run --plugin my_method.py --methods linear,bc --envs swingup --budget smoke",
    ),
    "irl-bench tune": (
        "irl-bench tune --methods gail,csil --envs swingup --trials 20 --storage tuning.db",
        "irl-bench tune --methods gail --envs swingup --trials 10 --storage random.db --sampler random",
    ),
    "irl-bench reproduce": (
        "irl-bench reproduce",
        "irl-bench reproduce --budget smoke --seeds 1 --out results/try",
    ),
    "irl-bench report": (
        "irl-bench report results/latest",
        "irl-bench report results/reproduce/absorbing",
    ),
    "irl-bench view": (
        "irl-bench view results/latest --env highway --compare",
        "irl-bench view results/latest --method shaped --export played",
    ),
    "irl-bench verify": (
        "irl-bench verify results/latest",
        "irl-bench verify results/reference/board/swingup_5",
    ),
    "irl-bench export": (
        "irl-bench export results/latest --env highway --method shaped --to learned",
        "irl-bench export results/latest --env highway --method shaped --policy pi_R --seed 1",
    ),
    "irl-bench demos": (
        "irl-bench demos export --env swingup --to expert.npz",
        "irl-bench demos inspect recorded.npz --env swingup",
    ),
    "irl-bench demos export": (
        "irl-bench demos export --env swingup --seed 0 --demos 20 --to expert.npz",
        "irl-bench demos export --env hopper --demonstrator noisy --to noisy.npz",
    ),
    "irl-bench demos import": (
        "irl-bench demos import trajectories/ --env hopper --to hopper.npz",
        "irl-bench demos import recorded.npz --env swingup --action-bounds=-2,2 --to swingup.npz",
    ),
    "irl-bench demos inspect": (
        "irl-bench demos inspect recorded.npz --env swingup",
        "irl-bench demos inspect recorded.npz --env swingup --action-bounds=-2,2",
    ),
    "irl-bench figure": (
        "irl-bench figure results/latest --to scores.pdf",
        "irl-bench figure results/latest --env highway --cost interactions --to highway.svg",
    ),
    "irl-bench table": (
        "irl-bench table results/latest --to scores.tex",
        "irl-bench table results/latest --env highway --to highway.md",
    ),
    "irl-bench compare": (
        "irl-bench compare results/before results/after",
        "irl-bench compare results/mine results/reference/board/swingup_5",
    ),
    "irl-bench check": (
        "irl-bench check linear --plugin my_method.py",
        "irl-bench check gym:MountainCarContinuous-v0",
    ),
    "irl-bench bench": (
        "irl-bench bench speed",
        "irl-bench bench --json",
    ),
    "irl-bench experts": (
        "irl-bench experts check swingup",
        "irl-bench experts train gym:MountainCarContinuous-v0",
    ),
    "irl-bench experts train": (
        "irl-bench experts train swingup --dir results/experts",
        "irl-bench experts train gym:MountainCarContinuous-v0 --budget quick --seeds 3",
    ),
    "irl-bench experts check": (
        "irl-bench experts check",
        "irl-bench experts check swingup,highway",
    ),
    "irl-bench list": (
        "irl-bench list",
        "irl-bench list gail --env hopper --budget full",
    ),
}


def told(command: str) -> str:
    """The examples of a command, such as 'irl-bench demos export', as the end of its help."""
    lines = "".join(f"  {example}\n" for example in EXAMPLES[command])
    return f"\nexamples:\n{lines}"
