"""Interpreters that are warm: a script runs in a fork of one that has imported what all import.

An interpreter with numpy, scipy and this package takes a second to start and ParaView's takes four,
again for every script, though few tests are about the start. So one is started for all; a script
gets a fork of it, which is a process of its own: with its own words, folder, environment, streams,
state and end. What is about the start itself has to start a program of its own.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import warm_launcher

INTERPRETER = Path(__file__).resolve().with_name("warm_interpreter.py")


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
    end : "end", "leave"
        Whether a script's process ends as the interpreter does, or leaves it as it is: sooner.

    Attributes
    ----------
    launcher : list of str
        A command that runs a script in the interpreter; the script's words come after it.
    """

    def __init__(self, command, modules, environment, end="end"):
        self.folder = Path(tempfile.mkdtemp(prefix="warm-"))  # a socket's path has to be short
        self.place = str(self.folder / "socket")
        self.launcher = [sys.executable, "-IS", warm_launcher.__file__, self.place]
        self.process = subprocess.Popen(
            [*command, INTERPRETER, end, self.place, *modules],
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
            code = warm_launcher.call(self.place, words, changes, cwd, streams, timeout)
            output.seek(0)
            return subprocess.CompletedProcess(words, code, output.read())

    def close(self):
        """End the interpreter, which its scripts have outlived if they have."""
        self.process.stdin.close()  # which it waits for
        self.process.wait()
        self.process.stdout.close()
        shutil.rmtree(self.folder)
