"""Several assumptions side by side: which of them the measured displacements prefer.

What is assumed besides the moduli (Poisson's ratio, pad and tissue stuck together, plane strain) is
changed one at a time and the map identified anew. Of the maps of the same displacements, that
assumption is preferred under which what is left of them is smallest for the parameters that it
took: with n measured numbers, S the weighted sum of what is left, squared, and df the effective
number of parameters,

    −2 log L  =  n log(S / n)  +  c · df,

Akaike's criterion where the size of the noise is not known (Burnham and Anderson, Model Selection
and Multimodel Inference, 2002, section 2.2), with a charge c of :data:`CHARGE` instead of 2: errors
of a registration are alike over neighbouring nodes, and a field that is free in every cell takes
them for stiffness (their section 2.5, overdispersion). Both S and df are those before the map is
sharpened, so that no choice of how far to sharpen comes in.

Whether bodies slide is asked of the same displacements: the nodes of the interface are split, and
what was measured at them, which is neither side's motion where the bodies did slide, has no weight;
stuck together is judged without it, too. So it needs no second registration; a map that is to be
read does.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from .errors import InputError
from .fem.contact import on_two_sides, split_nodes
from .fem.soundness import coincident
from .inverse.border import Frame
from .inverse.identify import identify
from .inverse.result import IdentificationResult
from .inverse.verdict import NOISE_FACTOR, doubted
from .progress import Progress, part, silent
from .results import Status

CHARGE = 7.0  # for a parameter, chosen by hand on the bodies that docs/evidence.md names
CLEAR = 10.0  # difference of log L from which an assumption is preferred
LOUDER = 1.05  # and how many times larger the noise must be without it
RATIO_STD, STRETCH_STD = 0.05, 0.01  # of ν and of the stretch, where they are estimated
GIVEN = "given"


@dataclass(frozen=True)
class Assumption:
    """One change of what was assumed.

    Attributes
    ----------
    key : str
        One word: given, poisson, lambda_mu, slip, stuck, stretch, plane_stress, plane_strain,
        neo_hookean.
    words : str
        For people, to follow «that».
    changes : dict
        Options of the identification that differ.
    holds_given : bool
        What was given is a special case of it, so that it can hardly be excluded.
    """

    key: str
    words: str
    changes: dict = field(default_factory=dict)
    holds_given: bool = False

    @property
    def options(self) -> str:
        """The options as one says them: ``unknowns=young, poisson_ratio=0.45``."""
        said = {name: value for name, value in self.changes.items() if value not in (None, ())}
        return ", ".join(f"{name}={value}" for name, value in said.items())


@dataclass
class Tried:
    """What came of one assumption.

    Attributes
    ----------
    assumption : Assumption
    result : IdentificationResult or None
        None where it could not be tried.
    refused : str
        Why not.
    noise : float
        What is left of the displacements, over what is left under the assumptions given.
    evidence : float
        log L less that of the assumptions given: positive where the data prefer it.
    """

    assumption: Assumption
    result: IdentificationResult | None = None
    refused: str = ""
    noise: float = np.nan
    evidence: float = np.nan


def explore(
    points: np.ndarray,
    cells,
    displacements: np.ndarray,
    known,
    *,
    result: IdentificationResult | None = None,
    progress: Progress | None = None,
    **options,
) -> list[Tried]:
    """Identify under each assumption, one at a time.

    Parameters
    ----------
    points, cells, displacements, known, **options
        As of :func:`~elastoidentify.identify`.
    result : IdentificationResult, optional
        Of the assumptions given, where it is there already.
    progress : callable, optional

    Returns
    -------
    list of Tried
        The assumptions given first.

    Raises
    ------
    InputError
        Where not even what was given can be identified. A rival that cannot be is `refused`.
    """
    progress = progress or silent
    check_method(options.get("method", "auto"))
    options |= {"method": "regularized"}
    u = np.asarray(displacements)
    case = _Case(points, cells, u if u.ndim == 3 else u[None], known, options)
    start = 0.0
    if result is None or result.report["method"] != "regularized":
        start = 0.2
        result = case.identify(progress=part(progress, 0.0, start))
    others = rivals(result.report, _pad_ratio(result), case.pairs(result), options)
    out = [Tried(Assumption(GIVEN, "what was given holds"), result, "", 1.0, 0.0)]
    for k, one in enumerate(others):
        ends = (start + (1 - start) * n / len(others) for n in (k, k + 1))
        out.append(_try(case, one, result, _named(part(progress, *ends), one)))
    progress(1.0, "explored")
    return out


def check_method(method: str) -> None:
    """Refuse methods that leave nothing of the displacements to weigh assumptions by."""
    if method not in ("auto", "regularized"):
        raise InputError(
            f"method '{method}' does not weigh assumptions: explore with method 'regularized' or "
            "'auto'"
        )


def rivals(report: dict, ratio: float, pairs, options: Mapping) -> list[Assumption]:
    """Return the assumptions to try besides those given.

    Parameters
    ----------
    report : dict
        Of the identification with those given.
    ratio : float
        Poisson's ratio of the known cells.
    pairs : list of (int, int)
        Known and unknown labels that touch.
    options : mapping
        Of the identification.
    """
    planar, stress = report["dimension"] == 2, report["plane"] == "stress"
    ratio = options.get("poisson_ratio") or round(float(ratio), 4)
    fixed = {"unknowns": "young", "poisson_ratio": ratio}
    young = options.get("unknowns", "lambda-mu") == "young"
    per_cell = options.get("grouping", "cell") == "cell"  # else both ways are one and the same
    out = []
    if not (young and options.get("poisson_std")) and (young or per_cell):
        words = "Poisson's ratio of the tissue is " + ("another one" if young else "one per label")
        out.append(Assumption("poisson", words, fixed | {"poisson_std": RATIO_STD}, young))
    if young and per_cell:
        free = {"unknowns": "lambda-mu", "poisson_ratio": None, "poisson_std": None}
        out.append(
            Assumption("lambda_mu", "Poisson's ratio differs from place to place", free, True)
        )
    if len(options.get("slip", ())):
        out.append(Assumption("stuck", "the bodies stick together", {"slip": ()}))
    elif pairs:
        words = "the known body slides on the tissue"
        out.append(Assumption("slip", words, {"slip": tuple(pairs)}))
    if planar and not stress and not options.get("out_of_plane_std"):
        words = "the tissue is stretched across the imaged plane"
        out.append(Assumption("stretch", words, {"out_of_plane_std": STRETCH_STD}, True))
    if planar:
        other = "strain" if stress else "stress"
        words = f"the body is {'thick (plane strain)' if stress else 'thin (plane stress)'}"
        changes = {"plane": other, "out_of_plane": (), "out_of_plane_std": None}
        if not stress and options.get("kinematics") == "neo-hookean":
            changes |= fixed | {"poisson_std": None}
        out.append(Assumption(f"plane_{other}", words, changes))
    if report["large_push"]:
        words = "strains are large (neo-hookean)"
        out.append(Assumption("neo_hookean", words, {"kinematics": "neo-hookean"}))
    return out


def record(result: IdentificationResult, tried: list[Tried]) -> None:
    """Put what was tried into a result: its report, and its verdict where it is contradicted."""
    report = result.report
    report["explored"] = said = summary(tried)
    result.tried = tried[1:]
    if said["preferred"] != GIVEN:
        report["verdict"] = doubted(report["verdict"], said["sentence"].rstrip("."))


def summary(tried: list[Tried]) -> dict:
    """Say which assumption the displacements prefer.

    Returns
    -------
    dict
        JSON-ready: ``preferred`` (key of an assumption), ``as_good`` (keys of others that the
        displacements do not tell from it), ``sentence``, ``rows`` (a dict per assumption).
    """
    weighed = [one for one in tried if one.result is not None]
    better = [one for one in weighed if is_better(one, weighed[0])]
    best = max(better or weighed[:1], key=lambda one: one.evidence)
    as_good = [one for one in weighed if one is not best and not is_better(best, one)]
    factor = weighed[0].result.report["verdict"]["noise_factor"]
    return {
        "preferred": best.assumption.key,
        "as_good": [one.assumption.key for one in as_good],
        "sentence": _sentence(best, as_good, factor),
        "rows": [_row(one, factor, one is best) for one in tried],
    }


def is_better(one: Tried, other: Tried) -> bool:
    """Tell whether the displacements speak clearly for one and against another."""
    return one.evidence - other.evidence > CLEAR and other.noise > LOUDER * one.noise


def _sentence(best, as_good, factor) -> str:
    told_apart = [one for one in as_good if not one.assumption.holds_given]
    if best.assumption.key == GIVEN:
        if factor is not None and factor > NOISE_FACTOR:
            return (
                "No other assumption that was tried explains the measured motion better: the cause "
                "lies elsewhere (an unknown push at a border, fibres, a failed registration)."
            )
        first = "What was assumed stands: the measured motion speaks for no other assumption tried"
    else:
        told_apart = [one for one in as_good if one.assumption.key != GIVEN]
        first = (
            f"The measured motion speaks for another assumption, that {best.assumption.words}: "
            f"what stays unexplained is then {_smaller(best.noise)}"
        )
    if not told_apart:
        return f"{first}."
    others = " or ".join(f"that {one.assumption.words}" for one in told_apart)
    return f"{first}; it does not tell this apart from the assumption {others}."


def _smaller(ratio: float) -> str:
    return f"{1 - ratio:.0%} smaller" if ratio > 0.6 else f"{1 / ratio:.2g} times smaller"


def _row(one: Tried, factor, preferred: bool) -> dict:
    """One line of the table: plain numbers and words, the figures of each label at its end."""
    out = {
        "assumption": one.assumption.key,
        "words": one.assumption.words,
        "options": one.assumption.options,
        "preferred": preferred,
        "noise": _finite(one.noise),
        "noise over stated": None if factor is None else _finite(factor * one.noise),
        "evidence": _finite(one.evidence),
        "parameters": None,
        "verdict": "",
        "refused": one.refused,
    }
    if one.result is not None:
        out["parameters"] = one.result.report["effective_parameters"]
        out["verdict"] = one.result.report["verdict"]["level"]
        for row in one.result.statistics:
            if not row["given"]:
                name = f"Mu of label {row['label']}"
                out[name] = row["Mu mean"]
                out[f"{name}, standard error"] = row["Mu standard error"]
    return out


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _named(progress, one):
    return lambda fraction, text: progress(fraction, f"{one.key}: {text}")


def _try(case, one, given, progress) -> Tried:
    try:
        if one.key not in ("slip", "stuck"):
            result = case.identify(progress=progress, **one.changes)
            return _weighed(one, result, given)
        slip = one.changes["slip"] or case.options["slip"]
        together, apart = case.together_and_apart(slip, given)
        stuck = together.identify(progress=part(progress, 0.0, 0.5), slip=())
        slides = apart.identify(progress=part(progress, 0.5, 1.0), slip=slip)
        return _weighed(one, *((slides, stuck) if one.key == "slip" else (stuck, slides)))
    except InputError as refused:
        return Tried(one, refused=str(refused))


def _weighed(one, result, reference) -> Tried:
    """Weigh a map against another one of the same displacements."""
    n = reference.report["equations"]
    first, second = (_minus_two_log(r.report, n) for r in (reference, result))
    noise = [r.report["noise_before_sharpening"] for r in (result, reference)]
    return Tried(one, result, "", noise[0] / noise[1], (first - second) / 2)


def _minus_two_log(report: dict, n: int) -> float:
    df, count = report["effective_parameters"], report["equations"]
    left = report["noise_before_sharpening"] ** 2 * max(count - df, 0.05 * count)
    return n * np.log(left / n) + CHARGE * df


def _pad_ratio(result) -> float:
    return float(np.median(result.poisson[result.status == Status.KNOWN]))


@dataclass(frozen=True)
class _Case:
    """What :func:`identify` is given."""

    points: np.ndarray
    cells: object
    displacements: np.ndarray
    known: object
    options: dict

    def identify(self, progress=None, **changes) -> IdentificationResult:
        options = {"slip": (), **self.options, **changes}
        return identify(
            self.points, self.cells, self.displacements, self.known, **options, progress=progress
        )

    def pairs(self, result) -> list[tuple[int, int]]:
        """Return the known and unknown labels that share a side."""
        labels = self.options.get("labels")
        if labels is None:
            return []
        labels = np.asarray(labels)
        known = result.status == Status.KNOWN
        sides, _ = Frame(self.points, self.cells).mesh.interfaces
        sides = sides[known[sides[:, 0]] & ~known[sides[:, 1]]] if len(sides) else sides
        # a label of which a part is known does not slide on itself
        return [(a, b) for a, b in np.unique(labels[sides], axis=0).tolist() if a != b]

    def together_and_apart(self, slip, given):
        """Return the case with one node per place and with one for each side of an interface.

        In neither has what was measured at the interface any weight.
        """
        blocks, labels = Frame(self.points, self.cells).blocks, np.asarray(self.options["labels"])
        if len(self.options.get("slip", ())):
            here = on_two_sides(len(self.points), blocks, labels, slip)
            first = coincident(np.asarray(self.points, float), blocks, joined=here)
            twice = first != np.arange(len(first))
            twice[first[twice]] = True
            told = self._silenced(twice, given)
            return replace(told, cells=[(kind, first[nodes]) for kind, nodes in blocks]), told
        if len(blocks) > 1 or blocks[0][0] not in ("triangle", "tetra"):
            raise InputError("an interface is split in a mesh of triangles or of tetrahedra only")
        ((kind, cells),) = blocks
        cells, origin = split_nodes(cells, labels, slip)
        told = self._silenced(np.bincount(origin, minlength=len(self.points)) > 1, given)
        return told, told._renumbered(origin, [(kind, cells)])

    def _silenced(self, nodes, given):
        """Return the case without what was measured at some nodes, (n_nodes,) bool."""
        options, u = dict(self.options), np.asarray(self.displacements, float)
        information = options.get("information")
        if information is None:
            size = options.get("noise") or given.report["noise_before_sharpening"]
            information = np.broadcast_to(np.eye(u.shape[-1]) / size**2, (*u.shape, u.shape[-1]))
        options["information"] = np.where(nodes[:, None, None], 0.0, information)
        return replace(self, options=options | {"noise": None})

    def _renumbered(self, origin, cells):
        """Return the case with other cells; `origin` (n,) is the old number of each node."""
        options = dict(self.options)
        for name in ("reaction_nodes", "outer_border"):
            if options.get(name) is not None:
                options[name] = np.asarray(options[name])[origin]
        options["information"] = options["information"][:, origin]
        u = np.asarray(self.displacements)[:, origin]
        return _Case(np.asarray(self.points)[origin], cells, u, self.known, options)
