"""Slicer module: stiffness of soft tissue from images alone."""

import importlib.metadata
import logging
import os
import time
from typing import Annotated

import numpy as np
import qt
import slicer
import vtk
from elastoidentify.results import QUANTITIES
from slicer import (
    vtkMRMLMarkupsROINode,
    vtkMRMLModelNode,
    vtkMRMLScalarVolumeNode,
    vtkMRMLSegmentationNode,
    vtkMRMLTransformNode,
)
from slicer.i18n import tr as _
from slicer.i18n import translate
from slicer.parameterNodeWrapper import Choice, parameterNodeWrapper
from slicer.ScriptedLoadableModule import (
    ScriptedLoadableModule,
    ScriptedLoadableModuleLogic,
    ScriptedLoadableModuleTest,
    ScriptedLoadableModuleWidget,
)
from slicer.util import VTKObservationMixin

SAMPLE = "ElastoIdentify phantom"
SAMPLE_3D = "ElastoIdentify 3-D phantom"
POLLING_INTERVAL = 200  # milliseconds


class ElastoIdentify(ScriptedLoadableModule):
    """What Slicer shows of the module in its menus and help."""

    def __init__(self, parent):
        ScriptedLoadableModule.__init__(self, parent)
        self.parent.title = "ElastoIdentify"
        self.parent.categories = [translate("qSlicerAbstractCoreModule", "Quantification")]
        self.parent.dependencies = []
        self.parent.contributors = ["The ElastoIdentify authors"]
        self.parent.helpText = _(
            "Stiffness of soft tissue from images alone: a block of tissue is imaged at rest and "
            "while a pad of known stiffness pushes it; the Lamé constants of every cell of a mesh "
            "follow from how the tissue moved. Cells that the images do not determine are shown "
            'as such. See the <a href="https://github.com/elastoidentify/SlicerElastoIdentify/'
            'blob/main/docs/slicer.md">tutorial</a>. A research tool, no medical device.'
        )
        self.parent.acknowledgementText = _(
            "Displacements are measured with elastix (Klein et al., IEEE Transactions on Medical "
            "Imaging 29, 2010)."
        )
        slicer.app.connect("startupCompleted()", onStartup)


def onStartup():
    """Make known what the application should have before the panel is first opened."""
    from ElastoIdentifyLib.views import register_layout

    register_layout()  # for scenes that were saved with it
    registerSampleData()


def registerSampleData():
    """Add the phantoms to the Sample Data module."""
    import SampleData

    icons = os.path.join(os.path.dirname(__file__), "Resources", "Icons")
    for name, load in ((SAMPLE, loadSample), (SAMPLE_3D, loadSampleVolume)):
        SampleData.SampleDataLogic.registerCustomSampleDataSource(
            category="ElastoIdentify",
            sampleName=name,
            thumbnailFileName=os.path.join(icons, "ElastoIdentifyPhantom.png"),
            uris=["generated"],
            fileNames=[name],
            nodeNames=[None],
            checksums=[None],
            customDownloader=load,
        )


def loadSample(source=None):
    """Make the phantom's nodes in the scene; needs no network. Returns the nodes, rest first."""
    from ElastoIdentifyLib.sample import add_phantom
    from ElastoIdentifyLib.views import show_volume

    nodes = add_phantom(_tell)
    show_volume(nodes[0])
    return nodes


def loadSampleVolume(source=None):
    """Make the nodes of the 3-D phantom in the scene, as loadSample does."""
    from ElastoIdentifyLib.sample import add_phantom_volume
    from ElastoIdentifyLib.views import show_volume

    nodes = add_phantom_volume(lambda fraction, text: _tell(fraction, text, SAMPLE_3D))
    show_volume(nodes[0])
    return nodes


def _tell(fraction, text, name=SAMPLE):
    """Show progress in the status bar; nothing can be clicked meanwhile."""
    slicer.util.showStatusMessage(f"{name}: {100 * fraction:.0f} %, {text}", 2000)
    slicer.app.processEvents(qt.QEventLoop.ExcludeUserInputEvents)


def _parameterNode():
    """Return the class of the panel's choices, which are stored in the scene.

    What belongs to nodes of the scene is declared here, every option of the library by its own
    table of options. Meanings: ElastoIdentifyLib.request.Request; materials is JSON by segment id.
    """
    from ElastoIdentifyLib import parameters

    fields = {
        "restVolume": vtkMRMLScalarVolumeNode,
        "pushedVolumes": list[vtkMRMLScalarVolumeNode],
        "maskVolume": vtkMRMLScalarVolumeNode,
        "useTransforms": bool,
        "transforms": list[vtkMRMLTransformNode],
        "transformsToRest": bool,
        "segmentation": vtkMRMLSegmentationNode,
        "materials": str,
        "reactionRois": list[vtkMRMLMarkupsROINode],
        "wholeVolume": bool,
        "sliceAxis": Annotated[str, Choice(["i", "j", "k"])],
        "resultName": str,
        "resultModel": vtkMRMLModelNode,
        "replacePrevious": bool,
        "show": Annotated[str, Choice(list(QUANTITIES))],
    }
    defaults = {
        "useTransforms": False,
        "transformsToRest": False,
        "materials": "{}",
        "wholeVolume": False,
        "sliceAxis": "k",
        "resultName": "Stiffness",
        "replacePrevious": True,
        "show": "Mu",
    }
    fields |= parameters.annotations(defaults)
    # The library takes any word; a box of choices in the panel needs some, or Slicer connects none.
    fields["unit"], defaults["unit"] = Annotated[str, Choice(["kPa", "Pa", "MPa"])], "kPa"
    about = {"__doc__": _parameterNode.__doc__, "__module__": __name__, "__annotations__": fields}
    return parameterNodeWrapper(type("ElastoIdentifyParameterNode", (), {**about, **defaults}))


ElastoIdentifyParameterNode = _parameterNode()


class ElastoIdentifyWidget(ScriptedLoadableModuleWidget, VTKObservationMixin):
    """The panel: choices in the parameter node, Apply that turns into Cancel, a status line."""

    def __init__(self, parent=None):
        self.logic = None
        self.run = None
        self._parameterNode = None
        self._guiTag = None
        self._filling = False
        self._observedSegmentation = None
        self._reportedModel = None
        self._segmentIds = []
        VTKObservationMixin.__init__(self)
        ScriptedLoadableModuleWidget.__init__(self, parent)  # without a parent it calls setup()

    # ---- set-up and scene events

    def setup(self):
        ScriptedLoadableModuleWidget.setup(self)
        panel = slicer.util.loadUI(self.resourcePath("UI/ElastoIdentify.ui"))
        self.layout.addWidget(panel)
        self.ui = slicer.util.childWidgetVariables(panel)
        from ElastoIdentifyLib.parameters import add_widgets

        vars(self.ui).update(add_widgets(self.ui.advancedSection.layout(), self.ui, _))
        panel.setMRMLScene(slicer.mrmlScene)
        self.logic = ElastoIdentifyLogic()
        self.timer = qt.QTimer()
        self.timer.setInterval(POLLING_INTERVAL)
        self.timer.connect("timeout()", self.onTimer)

        self.ui.materialsTable.setColumnCount(len(_header()))
        self.ui.materialsTable.setHorizontalHeaderLabels(_header())
        self.ui.progressBar.visible = False

        self.addObserver(slicer.mrmlScene, slicer.mrmlScene.StartCloseEvent, self.onSceneStartClose)
        self.addObserver(slicer.mrmlScene, slicer.mrmlScene.EndCloseEvent, self.onSceneEndClose)
        # Between the two, boxes do not have the nodes yet and would write that into the scene.
        self.addObserver(
            slicer.mrmlScene, slicer.mrmlScene.StartImportEvent, self.onSceneStartImport
        )
        self.addObserver(slicer.mrmlScene, slicer.mrmlScene.EndImportEvent, self.onSceneEndImport)
        self.addObserver(slicer.mrmlScene, slicer.mrmlScene.NodeAddedEvent, self.onNodeAdded)
        self.ui.applyButton.connect("clicked(bool)", self.onApplyButton)
        self.ui.currentSliceButton.connect("clicked(bool)", self.onCurrentSlice)
        self.ui.restoreButton.connect("clicked(bool)", self.onRestore)
        self.ui.exportDicomButton.connect("clicked(bool)", lambda: self.onExport("dicom"))
        self.ui.exportNiftiButton.connect("clicked(bool)", lambda: self.onExport("nifti"))
        self.ui.exportHtmlButton.connect("clicked(bool)", lambda: self.onExport("html"))
        self.ui.pushedSelector.connect("checkedNodesChanged()", self.onListsChanged)
        self.ui.transformsSelector.connect("checkedNodesChanged()", self.onListsChanged)
        self.ui.reactionRoisSelector.connect("checkedNodesChanged()", self.onListsChanged)
        self.ui.materialsTable.connect("cellChanged(int,int)", self.onMaterialEdited)
        self.initializeParameterNode()

    def cleanup(self):
        self.cancelRun()
        self.setParameterNode(None)
        self.removeObservers()

    def enter(self):
        self.initializeParameterNode()
        self._scrollToTop()

    def _scrollToTop(self):
        """Show Apply: the area is that of all modules, and stays where the last one left it."""
        area = self.parent
        while area is not None and not area.inherits("QScrollArea"):
            area = area.parent()
        if area is not None:
            area.verticalScrollBar().setValue(0)

    def exit(self):
        # A run goes on while the user looks at other modules; the panel is refreshed on return.
        self._disconnectGui()

    def onSceneStartClose(self, caller=None, event=None):
        self.cancelRun()
        self.setParameterNode(None)

    def onSceneStartImport(self, caller=None, event=None):
        self.setParameterNode(None)

    def onSceneEndClose(self, caller=None, event=None):
        if self.parent.isEntered:
            self.initializeParameterNode()

    def onSceneEndImport(self, caller=None, event=None):
        self.onSceneEndClose()
        from ElastoIdentifyLib.views import draw_again, mend_camera

        model = self.logic.getParameterNode().resultModel
        # The views of the scene are set up after this event.
        qt.QTimer.singleShot(0, lambda: mend_camera(model))
        qt.QTimer.singleShot(1000, draw_again)

    def onNodeAdded(self, caller=None, event=None):
        if self.parent.isEntered:
            qt.QTimer.singleShot(0, self._suggest)  # when what is being loaded is there as a whole

    def initializeParameterNode(self):
        """Make sure that the parameter node is there, and suggest what can be guessed."""
        self.setParameterNode(self.logic.getParameterNode())
        self._suggest()

    def _suggest(self):
        """Choose a rest volume and a segmentation where none is chosen."""
        if self._parameterNode is None:
            return
        from ElastoIdentifyLib.request import suggested_rest, suggested_segmentation

        if self._parameterNode.restVolume is None:
            self._parameterNode.restVolume = suggested_rest()
        if self._parameterNode.segmentation is None:
            self._parameterNode.segmentation = suggested_segmentation()

    def setParameterNode(self, parameterNode):
        self._disconnectGui()
        self._parameterNode = parameterNode
        if parameterNode is not None:
            self._guiTag = parameterNode.connectGui(self.ui)
            self.addObserver(parameterNode, vtk.vtkCommand.ModifiedEvent, self.onParametersModified)
            self.onParametersModified()

    def _disconnectGui(self):
        if self._parameterNode is not None and self._guiTag is not None:
            self._parameterNode.disconnectGui(self._guiTag)
            self._guiTag = None
            self.removeObserver(
                self._parameterNode, vtk.vtkCommand.ModifiedEvent, self.onParametersModified
            )

    # ---- panel and parameter node

    def onParametersModified(self, caller=None, event=None):
        """Bring the parts of the panel up to date that no property connects."""
        if self._parameterNode is None or self._filling:
            return
        from ElastoIdentifyLib.parameters import enable_what_is_used

        self._filling = True
        try:
            self._checkNodes(self.ui.pushedSelector, self._parameterNode.pushedVolumes)
            self._checkNodes(self.ui.transformsSelector, self._parameterNode.transforms)
            self._checkNodes(self.ui.reactionRoisSelector, self._parameterNode.reactionRois)
            self._observeSegmentation()
            self._fillMaterials()
            useTransforms = self._parameterNode.useTransforms
            self.ui.pushedSelector.enabled = not useTransforms
            self.ui.transformsSelector.enabled = useTransforms
            self.ui.transformsToRestCheckBox.enabled = useTransforms
            enable_what_is_used(self.ui, self._parameterNode)
            for widget in (
                self.ui.sliceAxisComboBox,
                self.ui.sliceIndexSpinBox,
                self.ui.currentSliceButton,
            ):
                widget.enabled = not self._parameterNode.wholeVolume
        finally:
            self._filling = False
        self._showQuantity()
        self._updateResultButtons()
        self._showReport()
        self.updateApplyButton()

    def _updateResultButtons(self):
        """What can be done with a result needs one."""
        from ElastoIdentifyLib.outputs import is_map, previous_result

        self.ui.restoreButton.enabled = previous_result() is not None
        for button in (
            self.ui.exportDicomButton,
            self.ui.exportNiftiButton,
            self.ui.exportHtmlButton,
        ):
            button.enabled = is_map(self._parameterNode.resultModel)

    def _showReport(self):
        """Say of every result that is chosen how far to trust it, also of one that was saved."""
        from ElastoIdentifyLib.outputs import is_map

        model = self._parameterNode.resultModel
        if model is self._reportedModel:
            return
        self._reportedModel = model
        self._status(self.logic.reportOf(model) if is_map(model) else "")

    @staticmethod
    def _checkNodes(selector, nodes):
        for node in selector.checkedNodes():
            if node not in nodes:
                selector.setCheckState(node, qt.Qt.Unchecked)
        for node in nodes:
            if node is not None and selector.checkState(node) != qt.Qt.Checked:
                selector.setCheckState(node, qt.Qt.Checked)

    def onListsChanged(self):
        if self._parameterNode is None or self._filling:
            return
        wasModified = self._parameterNode.StartModify()
        self._parameterNode.pushedVolumes = list(self.ui.pushedSelector.checkedNodes())
        self._parameterNode.transforms = list(self.ui.transformsSelector.checkedNodes())
        self._parameterNode.reactionRois = list(self.ui.reactionRoisSelector.checkedNodes())
        self._parameterNode.EndModify(wasModified)

    def _observeSegmentation(self):
        """Follow segments that are added, renamed or removed."""
        segmentation = self._parameterNode.segmentation
        if self._observedSegmentation is segmentation:
            return
        for event in _segmentEvents():
            if self._observedSegmentation is not None:
                self.removeObserver(self._observedSegmentation, event, self.onParametersModified)
            if segmentation is not None:
                self.addObserver(segmentation, event, self.onParametersModified)
        self._observedSegmentation = segmentation

    def _fillMaterials(self):
        from ElastoIdentifyLib.request import (
            ROLES,
            materials_from_text,
            role_names,
            segment_names,
            suggested_material,
        )

        table = self.ui.materialsTable
        materials = materials_from_text(self._parameterNode.materials)
        names = segment_names(self._parameterNode.segmentation)
        unit = self._parameterNode.unit
        table.setHorizontalHeaderLabels(_header(unit))
        if list(names) != self._segmentIds or table.rowCount != len(names):
            self._segmentIds = list(names)
            table.setRowCount(len(names))
            for row in range(len(names)):
                roles = qt.QComboBox()
                roles.addItems(role_names())
                roles.connect("currentIndexChanged(int)", self.onMaterialEdited)
                table.setCellWidget(row, 1, roles)
                for column in (0, 2, 3):
                    table.setItem(row, column, qt.QTableWidgetItem(""))
                table.item(row, 0).setFlags(qt.Qt.ItemIsEnabled)
        for row, (segmentId, name) in enumerate(names.items()):
            material = materials.get(segmentId) or suggested_material(
                self._parameterNode.segmentation, segmentId
            )
            segments = self._parameterNode.segmentation.GetSegmentation()
            table.item(row, 0).setText(name)
            table.item(row, 0).setIcon(_swatch(segments.GetSegment(segmentId).GetColor()))
            table.cellWidget(row, 1).setCurrentIndex(ROLES.index(material.role))
            known = material.role == "known"
            editable = qt.Qt.ItemIsEnabled | qt.Qt.ItemIsSelectable | qt.Qt.ItemIsEditable
            for column, value in ((2, material.young), (3, material.poisson)):
                table.item(row, column).setText(f"{value:g}" if known else "")
                table.item(row, column).setFlags(editable if known else qt.Qt.NoItemFlags)

    def onMaterialEdited(self, *_ignored):
        """Write the table to the parameter node."""
        if self._parameterNode is None or self._filling:
            return
        from ElastoIdentifyLib.request import (
            ROLES,
            Material,
            materials_from_text,
            materials_to_text,
            suggested_material,
        )

        table = self.ui.materialsTable
        materials = materials_from_text(self._parameterNode.materials)
        for row, segmentId in enumerate(self._segmentIds):
            material = materials.get(segmentId) or suggested_material(
                self._parameterNode.segmentation, segmentId
            )
            wasKnown = material.role == "known"
            role = ROLES[table.cellWidget(row, 1).currentIndex]
            young, poisson = material.young, material.poisson
            if wasKnown:
                young = _number(table.item(row, 2).text(), float("nan"))
                poisson = _number(table.item(row, 3).text(), float("nan"))
            materials[segmentId] = Material(role, young, poisson)
        self._parameterNode.materials = materials_to_text(materials)

    def onCurrentSlice(self, checked=False):
        """Take the slice that the red view shows."""
        volume = self._parameterNode.restVolume
        if volume is None:
            return
        sliceNode = slicer.mrmlScene.GetNodeByID("vtkMRMLSliceNodeRed")
        if sliceNode is None:
            return
        axis, index = self.logic.sliceOfView(volume, sliceNode)
        wasModified = self._parameterNode.StartModify()
        self._parameterNode.sliceAxis = "ijk"[axis]
        self._parameterNode.sliceIndex = index
        self._parameterNode.EndModify(wasModified)

    def _showQuantity(self):
        model = self._parameterNode.resultModel
        shown = self._parameterNode.show
        if model is None or model.GetDisplayNode() is None or model.GetMesh() is None:
            return
        if not model.GetMesh().GetCellData().HasArray(shown):  # some other model of the scene
            return
        if model.GetDisplayNode().GetActiveScalarName() != shown:
            from ElastoIdentifyLib.outputs import show_quantity

            show_quantity(model, shown)

    # ---- what is done with a result

    def onRestore(self, checked=False):
        """Change the result and the one that it replaced."""
        from ElastoIdentifyLib.outputs import exchange
        from ElastoIdentifyLib.views import show_figures

        self._parameterNode.resultModel = exchange(self._parameterNode.resultModel)
        show_figures(self._parameterNode.resultModel)

    def onExport(self, kind):
        """Ask where to, install what is missing, and write."""
        target = self._askTarget(kind)
        if not target:
            return
        from ElastoIdentifyLib.translation import refused_in_users_language

        failed = _("The map could not be written.")
        with (
            slicer.util.tryWithErrorDisplay(failed, waitCursor=True),
            refused_in_users_language(),
        ):
            files = self.logic.export(self._parameterNode.resultModel, kind, target)
            names = ", ".join(file.name for file in files)
            self._status(_("Wrote {names}").format(names=names))

    def _askTarget(self, kind):
        window = slicer.util.mainWindow()
        if kind == "dicom":
            return qt.QFileDialog.getExistingDirectory(window, _("Folder for the DICOM files"))
        name = self._parameterNode.resultModel.GetName()
        if kind == "nifti":
            title = _("Beginning of the names of the NIfTI images")
            return qt.QFileDialog.getSaveFileName(window, title, name)
        title = _("Report")
        return qt.QFileDialog.getSaveFileName(window, title, f"{name}.html", "HTML (*.html)")

    # ---- the run

    def updateApplyButton(self):
        """Say on the button what it does, or why it does nothing."""
        button = self.ui.applyButton
        if self.run is not None:
            button.text, button.enabled = _("Cancel"), True
            button.toolTip = _("Stop; the scene stays as it was")
            return
        missing = _("no scene")
        if self._parameterNode is not None:
            request = self.logic.request(self._parameterNode)
            missing = request.missing(self._parameterNode.useTransforms)
        button.text = _("Apply: {missing}").format(missing=missing) if missing else _("Apply")
        button.toolTip = missing or _("Compute the stiffness map")
        button.enabled = not missing

    def onApplyButton(self, checked=False):
        if self.run is not None:
            self.cancelRun()
            self._status(_("Cancelled; the scene is as it was."))
            return
        from ElastoIdentifyLib.translation import refused_in_users_language

        failed = _("The map could not be computed.")
        with (
            slicer.util.tryWithErrorDisplay(failed, waitCursor=True),
            refused_in_users_language(),
        ):
            if not self._parameterNode.useTransforms:
                self.logic.ensurePackages()
            self.run = self.logic.start(self.logic.request(self._parameterNode))
            self.ui.progressBar.visible = True
            self.ui.progressBar.value = 0
            self._status(_("Starting"))
            self.timer.start()
        self.updateApplyButton()

    def onTimer(self):
        """Look how the run is getting on."""
        if self.run is None:
            self.timer.stop()
            return
        from elastoidentify.workers.job import State
        from ElastoIdentifyLib.translation import refused_in_users_language, translated

        if self._poll() is State.RUNNING:
            self.ui.progressBar.value = round(100 * self.run.fraction)
            self._status(translated(self.run.text))
            return
        run, self.run = self.run, None
        self._endRun()
        with slicer.util.tryWithErrorDisplay(_("The map could not be computed.")):
            try:
                with refused_in_users_language():
                    self._finish(run)
            except Exception as problem:
                self._status(str(problem))
                raise

    def _poll(self):
        from elastoidentify.workers.job import State

        try:
            return self.run.poll()
        except Exception as problem:
            self.run.cancel()
            self.run.failure = problem
            return State.FAILED

    def _finish(self, run):
        failure = getattr(run, "failure", None)
        if failure is not None:
            raise failure
        parameters = self._parameterNode or self.logic.getParameterNode()
        result = self.logic.finish(
            run,
            name=parameters.resultName,
            show=parameters.show,
            replace=parameters.resultModel if parameters.replacePrevious else None,
        )
        parameters.resultModel = result.model
        self.logic.showResult(result, run.request)

    def cancelRun(self):
        """Stop a run that is under way, without a word."""
        if self.run is not None:
            self.run.cancel()
            self.run = None
            self._endRun()

    def _endRun(self):
        self.timer.stop()
        self.ui.progressBar.visible = False
        self.updateApplyButton()

    def _status(self, text):
        self.ui.statusLabel.text = text


def _header(unit=""):
    return [_("Segment"), _("Role"), f"E ({unit})" if unit else "E", "ν"]


def _asSentence(text):
    first = text.split(" ", 1)[0]
    if "_" not in first:  # else it is the name of an option
        text = text[:1].upper() + text[1:]
    return text.rstrip(".") + "."


def _swatch(colour):
    """Return a square in the colour of a segment."""
    pixmap = qt.QPixmap(16, 16)
    pixmap.fill(qt.QColor.fromRgbF(*colour))
    return qt.QIcon(pixmap)


def _segmentEvents():
    segmentation = slicer.vtkSegmentation
    return (segmentation.SegmentAdded, segmentation.SegmentRemoved, segmentation.SegmentModified)


def _number(text, otherwise):
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return otherwise


class ElastoIdentifyLogic(ScriptedLoadableModuleLogic):
    """MRML nodes in, MRML nodes out; the work is the library's."""

    def getParameterNode(self):
        return ElastoIdentifyParameterNode(super().getParameterNode())

    @staticmethod
    def request(parameterNode):
        """Return what the parameter node asks for."""
        from ElastoIdentifyLib.parameters import chosen
        from ElastoIdentifyLib.request import Request, materials_from_text

        options = chosen(parameterNode)
        edgeLength, sliceIndex, unit = (
            options.pop(name) for name in ("edge_length", "slice_index", "unit")
        )
        useTransforms = parameterNode.useTransforms
        return Request(
            restVolume=parameterNode.restVolume,
            segmentation=parameterNode.segmentation,
            materials=materials_from_text(parameterNode.materials),
            pushedVolumes=[] if useTransforms else _present(parameterNode.pushedVolumes),
            transforms=_present(parameterNode.transforms) if useTransforms else [],
            transformsToRest=parameterNode.transformsToRest,
            maskVolume=None if useTransforms else parameterNode.maskVolume,
            reactionRois=_present(parameterNode.reactionRois),
            edgeLength=edgeLength,
            wholeVolume=parameterNode.wholeVolume,
            sliceAxis="ijk".index(parameterNode.sliceAxis),
            sliceIndex=sliceIndex,
            options=options,
            unit=unit,
        )

    @staticmethod
    def start(request):
        """Start a run in the background and return it: poll it, cancel it, finish it."""
        from ElastoIdentifyLib.run import Run

        return Run(request)

    @staticmethod
    def finish(run, name="Stiffness", show="Mu", replace=None):
        """Put the outcome of a run into the scene; returns ElastoIdentifyLib.outputs.Result.

        The result of the model `replace`, if there is one, is put aside then, and stays as it is
        when the run has failed.
        """
        from ElastoIdentifyLib.outputs import make_result, replace_result

        outcome = run.outcome()
        for warning in outcome.warnings:
            logging.warning(warning)
        return replace_result(replace, lambda: make_result(outcome, run.request, name, show))

    @staticmethod
    def export(model, kind, target, ask=True):
        """Write a result as files: ElastoIdentifyLib.exports.export, with what it needs installed.

        Parameters
        ----------
        model : vtkMRMLModelNode
        kind : "dicom", "nifti", "html"
        target : str
            Folder, beginning of the files' names, or file.
        ask : bool
            Before a package is installed.
        """
        from ElastoIdentifyLib.exports import PACKAGES, export

        wanted = PACKAGES.get(kind, [])
        if wanted:
            _ensure(wanted, ask, _("This export"))
        return export(model, kind, target)

    def process(self, progress=None, name="Stiffness", show="Mu", **request):
        """Compute a map and wait for it; for scripts.

        Parameters
        ----------
        progress : callable(fraction, text), optional
            May raise to cancel; the scene is then as it was.
        name, show : str
            Name of the result; cell array to show.
        **request
            Fields of ElastoIdentifyLib.request.Request: restVolume, pushedVolumes, segmentation,
            materials, edgeLength, …

        Returns
        -------
        ElastoIdentifyLib.outputs.Result
            model, transforms, table, chart, folder, …
        """
        from elastoidentify.workers.job import State
        from ElastoIdentifyLib.request import Request

        run = self.start(Request(**request))
        try:
            while run.poll() is State.RUNNING:
                if progress:
                    progress(run.fraction, run.text)
                slicer.app.processEvents()
                time.sleep(0.05)
        except BaseException:
            run.cancel()
            raise
        return self.finish(run, name, show)

    @staticmethod
    def ensurePackages(ask=True):
        """Install what the registration needs and Slicer has not; ask=False for scripts."""
        requirements = os.path.join(os.path.dirname(__file__), "Resources", "requirements.txt")
        with open(requirements) as lines:
            wanted = [line.strip() for line in lines if line.strip() and line[0] != "#"]
        _ensure(wanted, ask, _("The registration"))

    @staticmethod
    def sliceOfView(volume, sliceNode):
        """Return (axis, index) of the volume's slice that a slice view shows best."""
        from ElastoIdentifyLib.images import ijk_to_world

        matrix = ijk_to_world(volume)
        toWorld = slicer.util.arrayFromVTKMatrix(sliceNode.GetSliceToRAS())
        across = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
        axis = int(np.abs(across.T @ toWorld[:3, 2]).argmax())
        index = np.linalg.solve(matrix, toWorld[:, 3])[axis]
        size = volume.GetImageData().GetDimensions()[axis]
        return axis, int(np.clip(round(index), 0, size - 1))

    @staticmethod
    def report(result):
        """Say in a few sentences what was found, and how far to trust it."""
        return ElastoIdentifyLogic.reportOf(result.model)

    @staticmethod
    def reportOf(model):
        """Say what :meth:`report` says, of the model of a result."""
        from elastoidentify.report.sentences import verdict_line
        from elastoidentify.results import Status, is_found
        from elastoidentify.vtk_io.arrays import read_report
        from ElastoIdentifyLib.translation import translated

        report = read_report(model.GetMesh(), "identification")
        status = slicer.util.arrayFromModelCellData(model, "Status")
        # Maps that were saved long ago have none.
        verdict = [translated(verdict_line(report))] if "verdict" in report else []
        found = _(
            "{found} of {cells} cells identified, {open} not determined (method {method})."
        ).format(
            found=int((is_found(status) & (status != Status.KNOWN)).sum()),
            cells=int((status != Status.KNOWN).sum()),
            open=int((status == Status.NOT_DETERMINED).sum()),
            method=report.get("method", "?"),
        )
        warnings = [_asSentence(translated(one)) for one in report.get("warnings", [])]
        explored = report.get("explored")
        if explored and explored["preferred"] == "given":  # else the verdict says so
            found = f"{found} {translated(explored['sentence'])}"
        return " ".join([*verdict, found, *warnings])

    @staticmethod
    def showResult(result, request):
        """Show the map over the rest volume, in 3-D, the table and the chart."""
        from ElastoIdentifyLib.views import show_result

        show_result(result, request)


def _ensure(wanted, ask, purpose):
    """Install packages that are missing, after asking."""
    try:
        from slicer.packaging import pip_ensure
    except ImportError:  # before Slicer 5.12
        _ensureByHand(wanted, ask, purpose)
        return
    pip_ensure(wanted, requester="ElastoIdentify", prompt_install=ask, prompt_restart=ask)


def _ensureByHand(wanted, ask, purpose):
    """Do what slicer.packaging.pip_ensure does from Slicer 5.12 on."""
    missing = [one for one in wanted if not _isInstalled(one)]
    if not missing:
        return
    about = {"purpose": purpose, "names": ", ".join(missing)}
    question = _("{purpose} needs the Python package {names}. Install it now?").format(**about)
    if ask and not slicer.util.confirmOkCancelDisplay(question):
        raise RuntimeError(_("{purpose} does not work without {names}.").format(**about))
    slicer.util.pip_install(missing)


def _isInstalled(requirement):
    name = requirement.partition(">")[0].partition("=")[0].strip()
    try:
        importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def _present(nodes):
    """Leave out nodes that are no longer in the scene."""
    return [node for node in nodes if node is not None]


class ElastoIdentifyTest(ScriptedLoadableModuleTest):
    """Tests with numbers in them; need no registration package, so they run everywhere."""

    def setUp(self):
        slicer.mrmlScene.Clear()

    def runTest(self):
        for name in sorted(dir(self)):
            if name.startswith("test_"):
                self.setUp()
                self.delayDisplay(name)
                getattr(self, name)()

    def test_aPushIsIdentifiedFromTransforms(self):
        """A block under its exact displacements: E of every identified cell to 0.1 %."""
        from ElastoIdentifyLib.sample import add_exact_push

        inputs, young = add_exact_push()
        result = ElastoIdentifyLogic().process(**inputs)
        label, status, found = (
            slicer.util.arrayFromModelCellData(result.model, name)
            for name in ("Label", "Status", "YoungModulus")
        )
        truth = np.array([young[value] for value in label])
        self.assertGreater((status == 2).mean(), 0.5)
        self.assertLess(np.abs(found / truth - 1)[status > 0].max(), 1e-3)
        self.assertTrue(np.isnan(found[status == 0]).all())
        self.assertEqual(result.table.GetNumberOfRows(), 2)

    def test_missingInputsAreNamed(self):
        """What is missing is said, in the order of the panel."""
        from ElastoIdentifyLib.request import Request

        self.assertEqual(Request().missing(), "choose a rest volume")
        logic = ElastoIdentifyLogic()
        self.assertRaises(ValueError, logic.process)
