"""`python -m harness`."""

import os
import sys

if __name__ == "__main__":
    # Modules of the current folder would hide others, such as a json.py, unless it is the program's own.
    _root = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
    if not sys.flags.safe_path and os.path.realpath(sys.path[0]) != _root:
        del sys.path[0]

try:
    import signal
    import warnings
except KeyboardInterrupt:  # which takes long enough on a slow machine
    sys.exit(130)


def start() -> int:
    """Do what the command line asks for. Return the exit code. For a process of its own."""
    try:
        return _start()
    except KeyboardInterrupt:  # before there is anybody who would tell of it
        return 130


def _start() -> int:
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # Ignored, it hides how processes end.
    os.environ["MPLBACKEND"] = "agg"  # Figures are files; what the user has set need not be there.
    if sys.warnoptions:  # -W and PYTHONWARNINGS could make errors of the libraries' warnings.
        sys.warnoptions.append("ignore")
        warnings.resetwarnings()
        warnings.simplefilter("ignore")

    from harness.process.signals import ignore_stops, importing

    with importing():
        from harness.cli.main import main
        from harness.process import streams

        streams.install()
    code = main()
    ignore_stops()  # It is done; to be stopped now would be a false report.
    sys.stdout.flush()
    if reason := streams.output_was_lost():
        print(f"irl-bench: error: standard output was cut short: {reason}", file=sys.stderr)
        code = code or 1
    if "ray" in sys.modules:  # Its threads may wait without an end for a head that is lost.
        sys.stderr.flush()
        os._exit(code)
    return code


if __name__ == "__main__":
    sys.exit(start())
