"""elastix in less time, for tests that judge neither the package's parameters nor its start.

How exact a registration with the parameters of the package is, is judged by Testing/library/
test_demo.py and Testing/imaging/test_volume.py, and by the phantoms of test_registration.py; how
elastix starts and ends by Testing/imaging/test_registration_worker.py. Where it is only one step of
what is tested it may stop sooner (the error of the phantoms' displacements grows by less than a
tenth, for the second step of the registration mends the rest), and wait for the next test.
"""

import re
from contextlib import contextmanager
from pathlib import Path

import pytest
from elastoidentify.imaging.registration import together
from elastoidentify.imaging.registration.parameter_files import FOLDER
from elastoidentify.workers.elastix_client import ElastixProcess

FEWER = {"MaximumNumberOfIterations": 100, "NumberOfSpatialSamples": 1024}


def quick_parameters(folder: Path) -> str:
    """Write the package's parameters, with fewer iterations and samples; return the file's path."""
    text = (FOLDER / "bspline.txt").read_text(encoding="utf-8")
    for name, value in FEWER.items():
        text, count = re.subn(rf"^\({name} \d+\)", f"({name} {value})", text, flags=re.M)
        assert count == 1, name
    file = Path(folder) / "quick.txt"
    file.write_text(text, encoding="utf-8")
    return str(file)


@contextmanager
def waiting_elastix():
    """Let what registers in this process take an elastix that waits, and leave it waiting."""
    waiting = []

    class Lent:
        def __init__(self, progress=None):
            self.process = waiting.pop() if waiting else ElastixProcess(progress)
            self.register = self.process.register

        def close(self):
            if self.process._process is not None:  # it was not stopped, nor did it crash
                waiting.append(self.process)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(together, "ElastixProcess", Lent)
        try:
            yield
        finally:
            for process in waiting:
                process.close()
