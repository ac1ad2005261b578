"""Running the benchmark: command line, experts, reinforcement learning, evaluation, storage, reports."""
