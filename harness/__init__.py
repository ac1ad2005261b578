"""Running the benchmark: command line, experts, reinforcement learning, evaluation, storage, reports."""

import sys

NO_NUMBERS = "It only says where the program runs."

if sys.platform == "win32":
    raise ImportError("irl-bench needs Linux or macOS; on Windows run it in WSL")
