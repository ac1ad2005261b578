"""The process in which plug-ins are loaded first, so that whatever they do as they are loaded is done there
(`harness.run.plugins`)."""

import json
import os
import signal
import sys
from contextlib import suppress

from harness.run import ours

NO_NUMBERS = "It looks at plug-ins before a run; cells import them anew."


def tell(request: str) -> None:
    """Write to standard output what plug-ins have, or why they cannot be used, and end this process.

    request: JSON of the path of modules, plug-ins, and entries of installed packages. The last line that is
    written counts: 'told' or 'error' with JSON, or 'at' with the plug-in that is being loaded.
    """
    path, named, wanted = json.loads(request)
    output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    with suppress(OSError):
        os.dup2(2, 1)  # what plug-ins print
    sys.path[:] = path
    ours.first()
    _alone()
    import msgspec

    from harness.engines.containment import bound_memory
    from harness.registry import BadInput, Entry
    from harness.run import plugins

    if hasattr(signal, "alarm"):
        signal.alarm(plugins.LONGEST + 5)  # in case that nobody waits any more
    at = "a plug-in"

    def say(kind: str, said: str) -> None:
        output.write(f"{kind} {said}\n")
        output.flush()

    def loading(what: str) -> None:
        nonlocal at
        at = what
        say("at", json.dumps(what))

    try:
        bound_memory()
        entries = [(kind, name, Entry(*entry)) for kind, name, entry in wanted]
        told = plugins.look([plugins.Plugin(*one) for one in named], entries, loading)
        say("told", msgspec.json.encode(told).decode())
    except BadInput as error:
        say("error", json.dumps(str(error)))
    except BaseException as error:
        say("error", json.dumps(f"{at} cannot be loaded: {plugins.in_words(error)}"))
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        os._exit(0)  # whatever else was started here


def _alone() -> None:
    """Go on in a child, where processes can have such. This one ends as its child does, and before that ends
    whatever was started there, in other sessions too."""
    if not hasattr(os, "fork"):
        return
    from harness.engines.containment import adopt_orphans, kill_descendants

    adopt_orphans()
    if not (child := os.fork()):
        return
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    kill_descendants()
    if code < 0:
        with suppress(OSError):  # of SIGKILL
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(abs(code))
