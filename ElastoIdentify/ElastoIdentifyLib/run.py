"""One run in the background, from nodes to an outcome. Touches the scene only to read it."""

from elastoidentify import pipeline
from elastoidentify.workers.job import BackgroundJob, State

from . import images
from .request import Request


class Run:
    """Mesh, displacements and identification of a request, in a background process.

    With given transforms it takes two steps: the mesh comes back first, because the transforms are
    evaluated at its nodes here, where the nodes of the scene are.

    Parameters
    ----------
    request : Request

    Raises
    ------
    InputError
        Something is missing, or a node cannot be used.
    """

    def __init__(self, request: Request):
        self.request = request
        self._study = request.study()
        self._notes = []
        self._first_step = bool(request.transforms)
        self._process = (
            BackgroundJob(pipeline.make_mesh, self._study) if self._first_step else self._whole()
        )

    def _whole(self, **given) -> BackgroundJob:
        about = {"names": self.request.names(), "inputs": self.request.inputs()}
        return BackgroundJob(pipeline.run, self._study, **about, **given)

    @property
    def fraction(self) -> float:
        """How much is done, 0 to 1."""
        return self._process.fraction * (0.05 if self._first_step else 1.0)

    @property
    def text(self) -> str:
        """What is being done."""
        return self._process.text

    def poll(self) -> State:
        """Go on if a step has ended, and tell the state; never waits."""
        state = self._process.poll()
        if self._first_step and state is State.DONE:
            mesh = self._process.result()
            moved = images.nodal_displacements(
                self.request.transforms, mesh.points, self.request.transformsToRest
            )
            self._notes = images.outside_grids(self.request.transforms, mesh.points)
            self._first_step = False
            self._process = self._whole(mesh=mesh, displacements=moved)
            return State.RUNNING
        return state

    def cancel(self) -> None:
        """Stop at once. The scene is as it was."""
        self._process.cancel()

    def outcome(self):
        """Return the outcome of the pipeline, or raise what went wrong."""
        outcome = self._process.result()
        outcome.warnings = self._notes + outcome.warnings
        return outcome
