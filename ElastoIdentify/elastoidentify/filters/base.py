"""What all filters of ElastoIdentify have in common.

VTK cannot pass a Python exception through its pipeline: an exception in ``RequestData`` is printed
and lost, and the caller goes on with empty data. So a filter here keeps the exception, shows it as
one line where VTK shows errors (ParaView's message window, or the terminal), empties its output,
and raises it from the Python call that asked for the update.

Warnings of a run go the same three ways: one line each where VTK shows warnings, the field data
array ``Warnings`` with one value per warning, and Python's ``warnings`` from the call that asked.
"""

import contextlib
import copy
import difflib
import re
import time
import warnings
import weakref
from dataclasses import dataclass
from typing import ClassVar

from vtkmodules.util.misc import calldata_type
from vtkmodules.util.vtkAlgorithm import VTKPythonAlgorithmBase
from vtkmodules.util.vtkConstants import VTK_STRING
from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkDataObject
from vtkmodules.vtkCommonExecutionModel import (
    vtkAlgorithm,
    vtkAlgorithmOutput,
)
from vtkmodules.vtkCommonExecutionModel import (
    vtkStreamingDemandDrivenPipeline as _Pipeline,
)
from vtkmodules.vtkFiltersCore import vtkAppendFilter

from ..errors import Cancelled, InputError
from ..options import Option, Picture, Table, options_of
from ..vtk_io.convert import all_texts
from .settings import add_settings

failure_listeners = []
"""Callables ``listener(filter, exception)`` that a host adds to learn of every failure."""

warning_listeners = []
"""Callables ``listener(filter, lines)`` that a host adds to learn of every run with warnings."""

stop_askers = []
"""Callables ``ask(began) -> bool`` that a host adds: whether to end a run that began then (s)."""

WARNINGS = "Warnings"
"""Field data array with a warning per value, of all filters so far."""


@dataclass(frozen=True)
class Port:
    """An input port: what it is called, the type of its data, whether it takes several or none.

    Every time step of what is connected to a port `over_time` is one more of its data objects,
    while the filter's ``time_steps_as_trials`` is on.
    """

    name: str
    data_type: str
    repeatable: bool = False
    over_time: bool = False
    optional: bool = False


class Filter(VTKPythonAlgorithmBase):
    """A VTK filter whose settings are keywords and properties, and whose failures raise.

    A subclass declares `ports`, its options (those of the `tables` of :mod:`elastoidentify.study`,
    and its own, see :mod:`elastoidentify.options`) and ``execute``, which gets one argument per
    port (a list where the port is repeatable or over time, None where an optional one is empty) and
    the progress callable, and returns the output, or a tuple of one per output port. It raises
    what it has to; nothing of a failed run reaches the output.

    Parameters
    ----------
    **settings
        Any option of the filter by name, e.g. ``LameIdentification(method="global")``.
    """

    ports: tuple[Port, ...] = ()
    output_types: tuple[str, ...] = ("vtkUnstructuredGrid",)
    refusals_wait: bool = False
    """A value that is not allowed is no exception of the setter, but the next run's failure."""
    _of_tables: ClassVar[dict[str, Option]] = {}

    def __init_subclass__(cls, tables: tuple[type[Table], ...] = (), **more):
        super().__init_subclass__(**more)
        for table in tables:
            cls._of_tables = {**cls._of_tables, **table.options()}
        add_settings(cls, {**cls._of_tables, **options_of(cls)})

    def __init__(self, **settings):
        self._errors, self._warnings, self._depth = [], [], 0
        self._refused, self._began = {}, 0.0
        self._step, self._earlier = 0, {}
        VTKPythonAlgorithmBase.__init__(
            self,
            nInputPorts=len(self.ports),
            nOutputPorts=len(self.output_types),
            outputType=next(iter(self.output_types), ""),
        )
        self.AddObserver("StartEvent", _run_starts)
        self.AddObserver("EndEvent", _run_ends)
        self._listen_to_executive()
        for name, value in settings.items():
            if not hasattr(type(self), name):
                raise TypeError(self._unknown(name))
            setattr(self, name, value)

    # ---- settings

    def __setattr__(self, name, value):
        if not (name.startswith("_") or hasattr(type(self), name) or name in _BASE_ATTRIBUTES):
            raise AttributeError(self._unknown(name))
        super().__setattr__(name, value)

    @classmethod
    def options(cls) -> dict[str, Option]:
        """Return the options of the class by name, in the order of declaration."""
        settings = {**cls._of_tables, **options_of(cls)}
        return {k: v for k, v in settings.items() if not isinstance(v, Picture)}

    def choices(self, table: type[Table]) -> Table:
        """Return the filter's settings that a table declares; its images are to be filled in."""
        names = [k for k, v in table.options().items() if not isinstance(v, Picture)]
        return table(**{name: getattr(self, name) for name in names})

    def _unknown(self, name: str) -> str:
        near = difflib.get_close_matches(name, dir(type(self)), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f"; it has {', '.join(self.options())}"
        return f"{self.GetClassName()} has no setting {name!r}{hint}"

    def GetClassName(self):
        """Return the filter's own name (VTK would say vtkPythonAlgorithm)."""
        return type(self).__name__

    # ---- inputs and outputs

    def FillInputPortInformation(self, port, info):
        """Declare every port optional: what is missing is said by name when the filter runs."""
        info.Set(vtkAlgorithm.INPUT_REQUIRED_DATA_TYPE(), self.ports[port].data_type)
        info.Set(vtkAlgorithm.INPUT_IS_OPTIONAL(), 1)
        if self.ports[port].repeatable:
            info.Set(vtkAlgorithm.INPUT_IS_REPEATABLE(), 1)
        return 1

    def FillOutputPortInformation(self, port, info):
        """Declare what each output port gives."""
        info.Set(vtkDataObject.DATA_TYPE_NAME(), self.output_types[port])
        return 1

    def SetInputData(self, *port_and_data):
        """Set the data of a port: ``SetInputData(data)`` or ``SetInputData(port, data)``."""
        self.SetInputDataObject(*port_and_data)

    def GetInput(self, port=0):
        """Return the first data object on a port, or None."""
        return self.GetInputDataObject(port, 0)

    def GetOutput(self, port=0):
        """Return the output."""
        return self.GetOutputDataObject(port)

    def _connect(self, port: int, source):
        """Put a data object, an algorithm or its output port on an input port (None: nothing)."""
        if source is None or isinstance(source, vtkDataObject):
            self.SetInputDataObject(port, source)
        else:
            self.SetInputConnection(port, _output_port(source))

    def _connect_one_more(self, port: int, source):
        if isinstance(source, vtkDataObject):
            self.AddInputDataObject(port, source)
        else:
            self.AddInputConnection(port, _output_port(source))

    # ---- running

    def execute(self, *inputs, progress):
        """Do the work: return the output data object or raise."""
        raise NotImplementedError

    def warnings_of(self, output) -> list[str]:
        """Return what the user should be told of an output of ``execute``, a sentence each."""
        return []

    def RequestDataObject(self, request, inInfo, outInfo):
        """Hear from now on what the executive refuses: a host may have put in its own."""
        self._listen_to_executive()
        return super().RequestDataObject(request, inInfo, outInfo)

    def RequestUpdateExtent(self, request, inInfo, outInfo):
        """Ask the ports over time for the step whose turn it is."""
        time_asked = bool(self.output_types) and outInfo.GetInformationObject(0).Has(
            _Pipeline.UPDATE_TIME_STEP()
        )
        as_trials = getattr(self, "time_steps_as_trials", False)
        for info in self._infos_over_time(inInfo):
            last = info.Length(_Pipeline.TIME_STEPS()) - 1
            if last >= 0 and (as_trials or not time_asked):  # VTK passes on a time asked for
                time = info.Get(_Pipeline.TIME_STEPS(), min(self._step, last))
                info.Set(_Pipeline.UPDATE_TIME_STEP(), time)
        return 1

    def RequestData(self, request, inInfo, outInfo):
        """Run, and publish the result only if all went well."""
        infos = [outInfo.GetInformationObject(i) for i in range(len(self.output_types))]
        outputs = [info.Get(vtkDataObject.DATA_OBJECT()) for info in infos]
        try:
            self._refuse_failed_inputs()
            for refused in self._refused.values():
                raise refused
            inputs = list(self._inputs(inInfo))
            if self._more_steps(inInfo):
                request.Set(_Pipeline.CONTINUE_EXECUTING(), 1)
                return 1
            request.Remove(_Pipeline.CONTINUE_EXECUTING())
            made = self.execute(*inputs, progress=self._report)
            made = made if isinstance(made, tuple) else (made,)
            if made:
                self._warn(made[0])
            for output, one in zip(outputs, made, strict=True):
                output.ShallowCopy(one)
        except (Exception, KeyboardInterrupt) as error:
            request.Remove(_Pipeline.CONTINUE_EXECUTING())
            self._step, self._earlier = 0, {}
            if not isinstance(error, _FailedBefore):
                self._fail(error)
            for output in outputs:
                output.Initialize()
            if self.GetExecutive().IsA("vtkPVCompositeDataPipeline"):
                return 1  # ParaView shows the empty output, and errors of its own for a 0
            for info in infos:
                info.Set(_Pipeline.DATA_NOT_GENERATED(), 1)  # the next update tries again
            return 0
        return 1

    def _inputs(self, inInfo):
        """Yield what ``execute`` gets, port by port."""
        for number, port in enumerate(self.ports):
            vector = inInfo[number]
            objects = [
                vector.GetInformationObject(i).Get(vtkDataObject.DATA_OBJECT())
                for i in range(vector.GetNumberOfInformationObjects())
            ]
            if not objects and port.optional:
                yield None
                continue
            if not objects:
                raise InputError(
                    f"no {port.name} given: connect a {port.data_type} to input port {number}"
                )
            if port.data_type == "vtkPointSet":
                objects = [_as_cells(data) for data in objects]
            if port.over_time:
                yield self._over_time(number, vector, objects)
            else:
                yield objects if port.repeatable else objects[0]

    def _refuse_failed_inputs(self):
        """Do nothing, without a second error line, where a filter before this one has failed."""
        if any(getattr(before, "_errors", None) for before in _upstream(self) if before != self):
            raise _FailedBefore

    # ---- time steps

    def _infos_over_time(self, inInfo):
        """Yield the information object of every connection whose time steps can be trials."""
        for number, port in enumerate(self.ports):
            if port.over_time:
                for i in range(inInfo[number].GetNumberOfInformationObjects()):
                    yield inInfo[number].GetInformationObject(i)

    def _over_time(self, number, vector, objects):
        """Return the objects of a port, all steps of the first connection first.

        Copies of earlier steps are kept in ``_earlier``: what is upstream reuses its object.
        """
        steps = [
            vector.GetInformationObject(i).Length(_Pipeline.TIME_STEPS())
            for i in range(len(objects))
        ]
        for i, data in enumerate(objects):
            if self._step < max(steps[i], 1):
                copied = data.NewInstance()
                copied.ShallowCopy(data)
                self._earlier.setdefault((number, i), []).append(copied)
        return [data for i in range(len(objects)) for data in self._earlier[number, i]]

    def _more_steps(self, inInfo) -> bool:
        """Go on to the next time step, or tell that there is none."""
        infos = self._infos_over_time(inInfo)
        steps = max((info.Length(_Pipeline.TIME_STEPS()) for info in infos), default=1)
        if getattr(self, "time_steps_as_trials", False) and self._step + 1 < steps:
            self._step += 1
            return True
        self._step, self._earlier = 0, {}
        return False

    # ---- progress

    def _report(self, fraction: float, text: str):
        """Show progress; the :data:`~elastoidentify.progress.Progress` handed to the library."""
        self.SetProgressText(text)
        self.UpdateProgress(min(max(float(fraction), 0.0), 1.0))
        if self.GetAbortExecute() or (hasattr(self, "CheckAbort") and self.CheckAbort()):
            raise Cancelled(f"{self.GetClassName()} was cancelled")
        if any(ask(self._began) for ask in stop_askers):
            raise Cancelled(f"{self.GetClassName()} was stopped")

    # ---- warning

    def _warn(self, made):
        """Tell the warnings of a run: window, field data, and :meth:`Update`."""
        lines = [f"{self.GetClassName()}: {' '.join(w.split())}" for w in self.warnings_of(made)]
        _write_warnings(made, lines, f"{self.GetClassName()}: ")
        if not lines:
            return
        self._warnings += lines
        text = "".join(f"WARNING: {line}\n" for line in lines)
        vtkOutputWindow.GetInstance().DisplayWarningText(text)
        for listener in warning_listeners:
            listener(self, lines)

    def _pass_on_warnings(self):
        """Give the new warnings of this filter, and of those before it, to Python."""
        for algorithm in _upstream(self):
            lines = getattr(algorithm, "_warnings", None) or []
            while lines:
                warnings.warn(lines.pop(0), stacklevel=3)

    # ---- failing

    def _fail(self, error: BaseException):
        if isinstance(error, InputError | Cancelled):
            error = error.with_traceback(None)  # says all by itself; frames would hold the data
        self._errors.append(error)
        self._listen_to_executive()
        if not isinstance(error, Cancelled):
            vtkOutputWindow.GetInstance().DisplayErrorText(f"ERROR: {self.GetLastError()}\n")
        for listener in failure_listeners:
            listener(self, error)

    def _listen_to_executive(self):
        """Hear what VTK's executive has to say, instead of letting it print its many lines."""
        executive = self.GetExecutive()
        if not executive.HasObserver("ErrorEvent"):
            executive.AddObserver("ErrorEvent", _executive_ear(weakref.ref(self)))

    def GetLastError(self) -> str:
        """Return the last run's failure as one line, ``""`` if it went well."""
        if not self._errors:
            return ""
        error = self._errors[0]
        text = " ".join(str(error).split())
        if not isinstance(error, InputError | Cancelled):
            text = f"{type(error).__name__}: {text}"
        return f"{self.GetClassName()}: {text}"

    @property
    def last_error(self) -> str:
        """The last run's failure as one line, ``""`` if it went well."""
        return self.GetLastError()

    def Update(self, *args):
        """Bring the output up to date, and raise what made this filter or one before it fail."""
        result = super().Update(*args)
        self._raise_first_error()
        self._pass_on_warnings()
        return result

    def UpdateWholeExtent(self):
        """Bring the whole output up to date, as :meth:`Update` does."""
        result = super().UpdateWholeExtent()
        self._raise_first_error()
        self._pass_on_warnings()
        return result

    def update(self, *args, **kwargs):
        """Bring the output up to date; ``filter.update().output`` is the output."""
        if hasattr(VTKPythonAlgorithmBase, "update"):
            return super().update(*args, **kwargs)
        self.Update()
        return self

    if not hasattr(VTKPythonAlgorithmBase, "output"):

        @property
        def output(self):
            """The output, as in newer VTK."""
            return self.GetOutput()

    def __call__(self, data=None):
        """Return a copy of the output for `data` on port 0; the filter keeps its connections."""
        connections = [self.GetInputConnection(0, i) for i in range(self._number_of_inputs())]
        producers = [connection.GetProducer() for connection in connections]  # kept alive
        try:
            if data is not None:
                self.SetInputData(data)
            self.Update()
            output = self.GetOutput().NewInstance()
            output.ShallowCopy(self.GetOutput())
        finally:
            if data is not None:
                self.RemoveAllInputConnections(0)
                for connection in connections:
                    self.AddInputConnection(0, connection)
            del producers
        return output

    def _number_of_inputs(self):
        return self.GetNumberOfInputConnections(0) if self.ports else 0

    def _raise_first_error(self):
        for algorithm in _upstream(self):
            errors = getattr(algorithm, "_errors", None)
            if errors:
                error, errors[0] = errors[0], _without_frames(errors[0])
                raise error


_BASE_ATTRIBUTES = {"NumberOfInputPorts", "NumberOfOutputPorts", "InputType", "OutputType"}


class _FailedBefore(Exception):
    """A filter further up has failed, and said so."""


def _run_starts(filter, event):
    """Forget the last run's failures and its cancel. A run over blocks holds one per block."""
    if filter._depth == 0:
        filter._began = time.time()
        filter._errors.clear()
        filter._warnings.clear()
        if filter.GetAbortExecute():
            filter.SetAbortExecute(0)
    filter._depth += 1


def _run_ends(filter, event):
    filter._depth = max(filter._depth - 1, 0)


def _executive_ear(reference):
    """Return an observer that keeps wrong connections as errors and drops VTK's echo of ours."""

    @calldata_type(VTK_STRING)
    def hear(executive, event, message):
        filter = reference()
        if filter is None or "returned failure for request" in message:
            return
        text = " ".join(message.split()).partition("): ")[2] or message
        error = InputError(re.sub(r" (for|of) algorithm \S+ ?\(0x\w+\)", "", text))
        if not filter._depth:
            filter._errors.clear()
        filter._fail(error)

    return hear


def _without_frames(error: BaseException) -> BaseException:
    """Return a copy to keep: what is raised holds the frames, and through them the filter."""
    try:
        return copy.copy(error)
    except TypeError:  # an exception whose constructor wants more than its message
        return RuntimeError(str(error))


def _write_warnings(data, lines: list[str], prefix: str):
    """Put warnings into the field data, in place of those of an earlier run of the same filter."""
    fields = data.GetFieldData()
    before = fields.GetAbstractArray(WARNINGS)
    before = [] if before is None else all_texts(before)
    every = [line for line in before if not line.startswith(prefix)] + lines
    fields.RemoveArray(WARNINGS)
    if every:
        array = vtkStringArray()
        array.SetName(WARNINGS)
        for line in every:
            array.InsertNextValue(line)
        fields.AddArray(array)


def _as_cells(data):
    """Return any kind of mesh as vtkUnstructuredGrid, with all its arrays."""
    if data.IsA("vtkUnstructuredGrid"):
        return data
    append = vtkAppendFilter()
    append.AddInputData(data)
    append.Update()
    grid = append.GetOutput()
    grid.GetFieldData().ShallowCopy(data.GetFieldData())
    return grid


def _output_port(source) -> vtkAlgorithmOutput:
    with contextlib.suppress(AttributeError):
        return source if isinstance(source, vtkAlgorithmOutput) else source.GetOutputPort()
    raise InputError(f"expected a data object or a filter, not {type(source).__name__}")


def _upstream(algorithm, seen=None):
    """Yield the algorithms that lead to `algorithm`, the first in the chain first."""
    seen = set() if seen is None else seen
    if algorithm is None or algorithm in seen:
        return
    seen.add(algorithm)
    for port in range(algorithm.GetNumberOfInputPorts()):
        for i in range(algorithm.GetNumberOfInputConnections(port)):
            connection = algorithm.GetInputConnection(port, i)
            yield from _upstream(connection and connection.GetProducer(), seen)
    yield algorithm
