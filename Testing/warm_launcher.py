"""Asks an interpreter that is warm to run a script, see `warm`.

As a program, `python warm_launcher.py SOCKET WORDS …` stands for the interpreter at that socket. It
imports little, to start at once.
"""

import json
import os
import signal
import socket
import sys


def call(place, words, changes, cwd, streams, timeout=None) -> int:
    """Let the interpreter at a socket run a script on three streams; return its exit code.

    Where the time is over before, the script is killed: TimeoutError.
    """
    said = {"words": words, "changes": changes, "cwd": str(cwd or os.getcwd())}
    with socket.socket(socket.AF_UNIX) as line:
        line.connect(place)
        socket.send_fds(line, [b"\n"], streams)
        line.sendall(json.dumps(said).encode() + b"\n")
        line.settimeout(timeout)
        answer = line.makefile()
        pid = int(answer.readline())
        try:
            return int(answer.readline())
        except TimeoutError:
            os.kill(pid, signal.SIGKILL)
            raise


if __name__ == "__main__":
    sys.exit(call(sys.argv[1], sys.argv[2:], dict(os.environ), None, [0, 1, 2]) & 0xFF)
