"""The program of the registration worker: runs elastix in a process of its own.

Why a process: itk-elastix holds Python's interpreter lock for a whole registration, ignores every
request to stop, and can crash with segmentation faults. In a process it can be killed, and its
crash is one error line instead of the end of the host.

Run as ``python elastix_engine.py`` this is the *guard*: it makes a temporary directory, starts the
*engine* (``--engine``) in it and passes the commands on. When its standard input ends, because the
host closed it, was killed or crashed, the guard kills the engine at once and removes the directory.

Wire format, the same in both directions: one line of JSON, then the raw bytes of the arrays listed
under ``"arrays"`` as ``[name, dtype, shape]``. Commands come on standard input, answers go to
standard output, elastix's log to standard error.

This file needs the standard library, numpy and itk-elastix, nothing of elastoidentify, so that any
interpreter which can import itk runs it.
"""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading


def send(stream, header, arrays=None):
    """Write one message: a JSON header and named numpy arrays."""
    arrays = {name: array for name, array in (arrays or {}).items() if array is not None}
    listed = [[name, array.dtype.str, list(array.shape)] for name, array in arrays.items()]
    stream.write(json.dumps({**header, "arrays": listed}).encode() + b"\n")
    for array in arrays.values():
        stream.write(array.tobytes())
    stream.flush()


def receive(stream):
    """Read one message. Returns (header, arrays), or None when the stream has ended."""
    import numpy as np

    line = stream.readline()
    if not line.endswith(b"\n"):
        return None
    header = json.loads(line)
    arrays = {}
    for name, dtype, shape in header.pop("arrays"):
        count = np.dtype(dtype).itemsize * math.prod(shape)
        data = stream.read(count)
        if len(data) != count:
            return None
        arrays[name] = np.frombuffer(data, dtype).reshape(shape)
    return header, arrays


# --- the engine: one registration per command ------------------------------------------------

NOT_WARPED = {"WriteResultImage": ["false"]}


class Elastix:
    """The classes of itk-elastix that a registration of float images takes, by dimension.

    ``itk.ElastixRegistrationMethod`` loads some fifty libraries that its module names and does not
    use, for ten seconds; the modules of the classes alone load in one. They are not the public face
    of ITK: where one is missing, the classes come the long way.
    """

    def __init__(self):
        try:
            import itk.elxParameterObjectPython as parameters
            import itk.itkElastixRegistrationMethodPython as methods
            import itk.itkPyBufferPython as buffers

            self.parameter_object = parameters.elastixParameterObject
            self.methods = {
                d: getattr(methods, f"itkElastixRegistrationMethodIF{d}IF{d}") for d in (2, 3)
            }
            self.buffers = {
                (kind, d): getattr(buffers, f"itkPyBufferI{kind}{d}")
                for kind in ("F", "UC")
                for d in (2, 3)
            }
        except (ImportError, AttributeError):
            self._publicly()

    def _publicly(self):
        import itk

        pixels = {"F": itk.F, "UC": itk.UC}
        images = {(kind, d): itk.Image[pixels[kind], d] for kind in pixels for d in (2, 3)}
        self.parameter_object = itk.ParameterObject
        self.methods = {d: itk.ElastixRegistrationMethod[(images["F", d],) * 2] for d in (2, 3)}
        self.buffers = {key: itk.PyBuffer[image] for key, image in images.items()}

    def image(self, array, spacing):
        """An ITK image that shows an array, its first voxel at the origin; `spacing` i, j(, k)."""
        kind = {"f": "F", "u": "UC"}[array.dtype.kind]
        image = self.buffers[kind, array.ndim].GetImageViewFromArray(array)
        image.SetSpacing([float(step) for step in spacing])
        return image

    def array(self, image, dimension):
        """A copy of the values of a float image."""
        return self.buffers["F", dimension].GetArrayFromImage(image)


def run_elastix(elastix, header, arrays):
    """Register `moving` to `fixed`, return T(points) and, if asked for, the moving image warped."""
    import numpy as np

    spacing, dimension = header["spacing"], arrays["fixed"].ndim
    fixed, moving = (elastix.image(arrays[name], spacing) for name in ("fixed", "moving"))
    maps = elastix.parameter_object.New()
    warp = header.get("warp", True)
    for parameter_map in header["maps"]:
        # warping a large volume takes as long as registering it
        maps.AddParameterMap(parameter_map if warp else {**parameter_map, **NOT_WARPED})
    method = elastix.methods[dimension].New()
    method.SetFixedImage(fixed)
    method.SetMovingImage(moving)
    method.SetParameterObject(maps)
    method.SetNumberOfThreads(1)  # more crash (ITKElastix issue 160)
    method.SetLogToConsole(True)
    if "mask" in arrays:
        method.SetFixedMask(elastix.image(arrays["mask"], spacing))
    method.UpdateLargestPossibleRegion()
    transform = method.GetCombinationTransform().TransformPoint
    points = arrays["points"]
    mapped = [tuple(transform(point)) for point in points.tolist()]
    result = {"mapped": np.array(mapped, float).reshape(points.shape)}
    if warp:
        result["warped"] = elastix.array(method.GetOutput(), dimension).astype(np.float32)
    return result


def engine():
    """Answer commands until the input ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # elastix prints its log to the standard output: send it where logs go
    elastix = Elastix()
    send(answers, {"ready": True})
    while (message := receive(sys.stdin.buffer)) is not None:
        try:
            result = run_elastix(elastix, *message)
        except Exception as error:  # whatever elastix raises goes to the host as text
            send(answers, {"error": f"{type(error).__name__}: {error}"})
        else:
            send(answers, {"done": True}, result)


# --- the guard: owns the engine and its directory --------------------------------------------


def guard():
    """Run the engine, pass standard input on to it, and clean up whatever happens."""
    directory = tempfile.mkdtemp(prefix="elastoidentify-elastix-")
    command = [sys.executable, os.path.abspath(__file__), "--engine"]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, cwd=directory)

    def stop(*_):
        process.kill()

    def pass_on():
        try:
            while data := os.read(0, 1 << 20):
                process.stdin.write(data)
                process.stdin.flush()
        except OSError:
            pass
        stop()

    for name in ("SIGTERM", "SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), stop)
    threading.Thread(target=pass_on, daemon=True).start()
    try:
        code = process.wait()
    finally:
        process.kill()
        process.wait()
        shutil.rmtree(directory, ignore_errors=True)
    # os._exit: the reading thread may hold the lock of the standard input for ever
    os._exit(code if code >= 0 else 128 - code)


if __name__ == "__main__":
    engine() if "--engine" in sys.argv else guard()
