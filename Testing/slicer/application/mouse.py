"""A hand for Slicer's window: clicks and keys that come from the X server, and pictures of it.

A tour is a generator that yields seconds to wait, or a question to wait for; meanwhile Slicer's own
event loop runs, as it does under a person's hand. Needs xdotool and ImageMagick.
"""

import subprocess
import time
import traceback

import qt
import slicer


def run(tour, finished):
    """Take the steps of a tour, then call `finished` with None or what went wrong."""
    timer = qt.QTimer()
    timer.setInterval(50)
    wait = {"until": 0.0, "question": None, "limit": 0.0, "busy": False}

    def step():
        if wait["busy"] or time.monotonic() < wait["until"]:
            return  # a step shows a dialog, and its event loop calls here
        wait["busy"] = True
        try:
            question = wait["question"]
            if question is not None and not question():
                if time.monotonic() > wait["limit"]:
                    raise TimeoutError(f"waited in vain for: {question.__doc__}")
                return
            asked = next(tour)
            wait["question"] = None
            if callable(asked):
                wait["question"], wait["limit"] = asked, time.monotonic() + asked.limit
            else:
                wait["until"] = time.monotonic() + asked
        except StopIteration:
            timer.stop()
            finished(None)
        except BaseException as problem:
            timer.stop()
            traceback.print_exc()
            finished(problem)
        finally:
            wait["busy"] = False

    timer.connect("timeout()", step)
    timer.start()
    return timer


def until(what, question, limit=60):
    """Return what a tour yields to wait for something."""

    def ask():
        return question()

    ask.__doc__, ask.limit = what, limit
    return ask


def _xdotool(*words):
    subprocess.run(["xdotool", *map(str, words)], check=True)


def place(widget, x=None, y=None):
    """Return where a point of a widget is on the screen; its middle, if none is given."""
    x = widget.width // 2 if x is None else x
    y = widget.height // 2 if y is None else y
    point = widget.mapToGlobal(qt.QPoint(int(x), int(y)))
    return point.x(), point.y()


def click(widget, x=None, y=None, times=1):
    """Click a widget with the left button."""
    if not widget.visible:
        raise AssertionError(f"{widget.objectName or widget} is not on the screen")
    _xdotool("mousemove", *place(widget, x, y), "sleep", 0.1)
    _xdotool("click", "--repeat", times, "--delay", 80, 1)


def click_item(view, index, times=1):
    """Click an item of a list, a tree or a table."""
    area = view.visualRect(index)
    x, y = area.x() + min(area.width() // 2, 40), area.y() + area.height() // 2
    click(view.viewport(), x, y, times)


def drag(widget, points):
    """Draw a line with the left button through points of a widget."""
    places = [place(widget, *point) for point in points]
    _xdotool("mousemove", *places[0], "mousedown", 1)
    for there in places[1:]:
        _xdotool("mousemove", *there, "sleep", 0.03)
    _xdotool("mouseup", 1)


def keys(*names):
    """Press keys, by their names in X."""
    _xdotool("key", "--delay", 60, *names)


def write(text):
    """Write text where the cursor is."""
    _xdotool("type", "--delay", 30, text)


def picture(path):
    """Save what is on the screen."""
    slicer.app.processEvents()
    subprocess.run(["import", "-window", "root", str(path)], check=True)
