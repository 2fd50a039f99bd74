"""Interpreters that are warm: a script runs in a fork of one that has imported what all import.

An interpreter with numpy, scipy and this package takes a second to start and ParaView's takes four,
again for every script, though few tests are about the start. So one is started for all; a script
gets a fork of it, which is a process of its own: with its own words, folder, environment, streams,
state and end. What is about the start itself has to start a program of its own.

As a program, `python warm.py SOCKET WORDS …` stands for the interpreter at that socket.
"""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

SERVER = Path(__file__).resolve().with_name("warm_interpreter.py")


class Warm:
    """An interpreter that waits with modules imported; to be closed.

    Parameters
    ----------
    command : list of str
        That starts the interpreter.
    modules : list of str
        What it imports, once for all.
    environment : dict
        That it is started in.
    """

    def __init__(self, command, modules, environment):
        self.folder = Path(tempfile.mkdtemp(prefix="warm-"))  # a socket's path has to be short
        self.place = str(self.folder / "socket")
        self.process = subprocess.Popen(
            [*command, SERVER, self.place, *modules],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        if self.process.stdout.readline() != "warm\n":
            self.close()
            raise RuntimeError(f"{command[0]} did not become a warm interpreter")

    def run(self, *words, cwd=None, timeout=300, **changes):
        """Run a script, or -c and code, as subprocess.run does; stdout and stderr are one text.

        `changes` are of the environment. What the modules take from there they have taken already.
        """
        words = [str(word) for word in words]
        with tempfile.TemporaryFile("w+") as output, open(os.devnull) as nothing:
            streams = [nothing.fileno(), output.fileno(), output.fileno()]
            code = call(self.place, words, changes, cwd, streams, timeout)
            output.seek(0)
            return subprocess.CompletedProcess(words, code, output.read())

    def close(self):
        """End the interpreter, which its scripts have outlived if they have."""
        self.process.stdin.close()  # which it waits for
        self.process.wait()
        self.process.stdout.close()
        shutil.rmtree(self.folder)


def call(place, words, changes, cwd, streams, timeout=None) -> int:
    """Let the interpreter at a socket run a script on three streams; return its exit code."""
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
            raise subprocess.TimeoutExpired(words, timeout) from None


if __name__ == "__main__":
    sys.exit(call(sys.argv[1], sys.argv[2:], dict(os.environ), None, [0, 1, 2]) & 0xFF)
