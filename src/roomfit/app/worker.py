"""The process in which files are read and long work is done: a line in, lines out, in JSON.

A hostile file may take memory or time, or end the process; the page stays. Answers go out through a
descriptor of their own, so that nothing that prints can disturb them.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
from typing import Any

_MIB = 2**20


def main() -> None:
    """Answer requests ``{"task": name, "arguments": {...}}`` until standard input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    _limit_memory(int(sys.argv[1]))
    requests: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests,), name="requests", daemon=True).start()

    from roomfit.app.views import TASKS  # after the limit, which the import needs not much of
    from roomfit.base.errors import RoomfitError
    from roomfit.base.forks import end_with_parent

    end_with_parent()  # the thread that listens has no turn while compiled code runs

    def send(**content: Any) -> None:
        answers.write(json.dumps(content, allow_nan=False) + "\n")
        answers.flush()

    send(ready=True)
    while True:
        request = requests.get()
        try:
            task = TASKS[request["task"]]
            send(answer=task(lambda part: send(progress=part), **request["arguments"]))
        except RoomfitError as error:
            send(error=str(error))
        except MemoryError:
            send(error="this needs more memory than it may have")
        except Exception as error:  # noqa: BLE001 -- the page must hear of it, and goes on
            sys.excepthook(type(error), error, error.__traceback__)
            send(error=f"a fault of roomfit: {type(error).__name__}: {error}"[:500])


def _listen(requests: queue.SimpleQueue[dict[str, Any]]) -> None:
    """Take requests; when the page has gone, end at once with all own processes."""
    for line in sys.stdin:
        requests.put(json.loads(line))
    os.killpg(os.getpgid(0), signal.SIGKILL)


def _limit_memory(most_mib: int) -> None:
    if not most_mib:
        return
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (most_mib * _MIB, most_mib * _MIB))


if __name__ == "__main__":
    main()
