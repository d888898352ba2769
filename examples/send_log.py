"""Send a log to ``examples/live_loop.py``, at the pace of the robot or as fast as it is taken.

    python examples/send_log.py walk.parquet tcp:9760 [--fast]
    python examples/send_log.py walk.parquet file:stream.jsonl [--fast]

Both need the extra ``[experiments]``.
"""

import argparse
import json
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from surefoot.experiments import Log, read_log
from surefoot.experiments.logs.description import describe
from surefoot.experiments.walks.replay import starting_map


def lines_of(log: Log) -> Iterator[tuple[float, dict]]:
    """Yield the description and then the samples, each with the time in s at which it is due."""
    yield 0.0, describe(replace(log, nominal=starting_map(log)))
    for k, now in enumerate(log.time.tolist()):
        reference = {key: part[k].tolist() for key, part in log.reference._asdict().items()}
        yield now - log.time[0], {"time_s": now, "raw": log.raw[k].tolist(), "reference": reference}


def send(log: Log, write: Callable[[str], object], wait: Callable[[], object], fast: bool = False) -> int:
    """Send a log line by line, and wait for each sample's answer.

    Returns:
        How many samples were sent.
    """
    began, count = time.monotonic(), 0
    for due, line in lines_of(log):
        if not fast:
            time.sleep(max(0.0, began + due - time.monotonic()))
        sample = "raw" in line
        write(json.dumps(line | {"sent_s": time.monotonic()} if sample else line) + "\n")
        if sample:
            wait()
            count += 1
    write("\n")
    return count


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Send a log to examples/live_loop.py.")
    parser.add_argument("log", type=Path)
    parser.add_argument("target", help="tcp:PORT of this machine, or file:PATH to write")
    parser.add_argument("--fast", action="store_true", help="as fast as it is taken, not at the robot's pace")
    given = parser.parse_args()
    kind, _, where = given.target.partition(":")
    if kind == "tcp":
        with (
            socket.create_connection(("127.0.0.1", int(where))) as link,
            link.makefile("r", encoding="utf-8") as answers,
        ):
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sent = send(read_log(given.log), lambda t: link.sendall(t.encode()), answers.readline, given.fast)
    else:
        with Path(where).open("w", encoding="utf-8", buffering=1) as file:
            sent = send(read_log(given.log), file.write, lambda: None, given.fast)
    print(f"{sent} samples sent")
