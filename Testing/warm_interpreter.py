"""The other end of `warm`: INTERPRETER warm_interpreter.py end|leave SOCKET MODULE …

Imports the modules, then waits. Every call gets a fork, which returns from `next_call` and runs its
script at the end of this file: at the top, so that with `end` what the script raises ends the
interpreter in the interpreter's own way.
"""

import atexit
import gc
import importlib
import json
import os
import select
import signal
import socket
import sys
import traceback

ON_SOCKET = 3  # streams: input, output, errors


def next_call(place):
    """Wait for calls until the standard input ends; returns in a fork for each, what it says."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for the forks here
    door = socket.socket(socket.AF_UNIX)
    door.bind(place)
    door.listen()
    print("warm", flush=True)
    while True:
        ready, _, _ = select.select([door, 0], [], [])
        if 0 in ready:
            os._exit(0)
        line, _ = door.accept()
        _, streams, _, _ = socket.recv_fds(line, 1, ON_SOCKET)
        if os.fork() == 0:
            door.close()
            return become(line, streams)
        line.close()
        close(streams)


def become(line, streams):
    """Fork once more: one tells how the other ends, which is as a process that was just started."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    said = json.loads(line.makefile().readline())
    pid = os.fork()
    if pid:
        close([0, 1, 2, *streams])  # else the script's would never be seen to end
        line.sendall(b"%d\n" % pid)
        _, status = os.waitpid(pid, 0)
        line.sendall(b"%d\n" % os.waitstatus_to_exitcode(status))
        os._exit(0)
    line.close()
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
    close(streams)
    os.chdir(said["cwd"])
    os.environ.update(said["changes"])
    return said["words"]


def run_and_leave(code, names):
    """Run code and end without taking the interpreter down, which takes longer than most runs."""
    status = 0
    try:
        exec(code, names)
    except SystemExit as end:
        status = end.code or 0
    except BaseException:
        traceback.print_exc()
        status = 1
    atexit._run_exitfuncs()
    sys.stdout.flush()
    os._exit(status)


def close(streams):
    """Close file descriptors."""
    for stream in streams:
        os.close(stream)


run = run_and_leave if sys.argv.pop(1) == "leave" else exec
for module in sys.argv[2:]:
    importlib.import_module(module)
gc.freeze()  # what is there now is not looked at again, in no fork, nor copied for that
sys.argv = next_call(sys.argv[1])
if sys.argv[0] == "-c":
    folder, path, code = "", "<string>", sys.argv.pop(1)
else:
    path = os.path.abspath(sys.argv[0])
    folder = os.path.dirname(path)
    with open(path, encoding="utf-8") as file:
        code = file.read()
if not getattr(sys.flags, "safe_path", False):
    sys.path[0] = folder
run(compile(code, path, "exec"), {"__name__": "__main__", "__file__": path})
