"""What the headings of tables mean."""

from __future__ import annotations

MEANINGS = {
    "Task": "The environment. In a variant its dynamics differ, and what was learned is carried over.",
    "Dynamics": "Those of the task as it is (nominal), or the variant of it.",
    "Demonstrations": "What of the expert is shown to methods.",
    "Method": (
        "Who learned. control_… are rewards or policies for comparison; reference is the expert and the "
        "random policy."
    ),
    "Role": (
        "A method is compared with the others. A lower control has a reward without information, the upper "
        "control the true reward."
    ),
    "Policy": (
        "π* (pi_star): what the method found itself. π_R (pi_R): what RL finds from scratch under the "
        "method's learned reward alone."
    ),
    "Score [95 %]": (
        "Normalized return under the true reward: 0 random, 1 the expert; in a variant 1 is RL on the true "
        "reward there. Brackets: 95 % interval of the mean over seeds (Student's t); with one seed over its"
        " evaluation episodes."
    ),
    "Behind the best [95 %]": (
        "How much less it scores than the best method's policy of the same name, paired by seed. 'tied': "
        "the interval holds 0, or less than 0.005. 'no seed in common': there is nothing to compare. The "
        "best has the highest mean that no method with as many seeds beats on the seeds that both have."
    ),
    "Above best lower control": (
        "Score less that of the best control whose reward has no information, over the seeds that all have. "
        "A learned reward has to be above 0 here."
    ),
    "Seeds ok": "Seeds that are finished without failure, of those that were asked for.",
    "Share of control_true": "Score in units of what RL reaches on the true reward in one solve.",
    "Reward: distance (floor)": (
        "From the true reward, by the advantages that it gives to actions: 0 the same up to scale, 1 the "
        "opposite. The floor is the distance of the reward from a shaped copy of itself: below it nothing "
        "can be told."
    ),
    "Reward: rank": "Spearman's correlation of the advantages under the learned and the true reward.",
    "Policies: rank": (
        "Spearman's correlation of the returns of twenty policies from bad to good, under the learned and "
        "the true reward."
    ),
    "Return [95 %]": "Undiscounted return under the true reward, mean over seeds.",
    "Discounted return": "The same, discounted with the task's gamma.",
    "Solved": (
        "Share of seeds on which π_R earns, under R*, 95 % of what π* earns above the random policy. On "
        "others its score says nothing about the reward, only about RL."
    ),
    "Own return": "Mean return under the learned reward, counted from what absorption pays.",
    "Of demonstrations": "The demonstrations' return under the learned reward, counted alike.",
    "Seconds": "Wall time of what made this policy, mean over seeds: the fit for π*, RL on R* for π_R.",
    "Env steps": (
        "Environment steps that it took: rollouts, and those that RL learned from. Checks are not in it."
    ),
    "Check steps": "Environment steps of the episodes by which RL's checkpoints were judged, besides.",
    "RL solves": "How often RL was run.",
    "Note": "Where a line comes from; which seeds were skipped, failed or not scored, and why.",
    "Environments": "How many environments it is over.",
    "Runs": "Scores that are counted: environments times seeds.",
    "Interquartile mean [95 %]": (
        "The mean of the middle half of all runs; the interval is of the stratified bootstrap (Agarwal et "
        "al. 2021)."
    ),
    "Runs below 0.95": "Share of the runs that score less than 0.95.",
    "Stage of a cell": "What a cell does in turn; 'start' is what its process takes besides.",
    "Seconds, all cells": "Wall time, summed over all cells.",
    "Share": "Of the time of all stages.",
    "Detail of its fit": "A number that the method tells of its own fit.",
    "Mean over seeds": "Of the seeds that tell it.",
    "Episodes by ending": "How many evaluation episodes of all seeds ended how.",
    "Cost": "What the policy took in all; for π_R the fit and RL on R* together.",
    "Unit": "Of the cost.",
    "On the front": "No other method scores as much for less.",
    "Score": "Normalized score, as in the leaderboard.",
    "Share of runs above": (
        "The share of the runs that score more, with its 95 % interval (stratified bootstrap)."
    ),
    "Better than it": "The method with the best mean score.",
    "Probability [95 %]": (
        "That a run of the best method scores more than one of this method, in a task drawn at random; "
        "equal scores count half (stratified bootstrap)."
    ),
    "Distance": "From the true reward, as in the leaderboard: 0 the same, 1 the opposite.",
    "Floor": "The distance of the reward from a shaped copy of itself.",
    "Episodes": "Demonstrations that were shown.",
    "Ended": "How the evaluation episodes of the policy ended, over all seeds.",
    "Play": "In this page's folder.",
}
"""By heading."""
