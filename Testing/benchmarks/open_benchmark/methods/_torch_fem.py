"""torch-fem's fits of property fields: as its example does them, on any problem of this benchmark.

Its example knows the load and the clamped end. Where a problem has forces they are given, and no
modulus is. Elsewhere nobody has measured a force: the measured motion of the reaction nodes is
prescribed, and the known cells keep their modulus. The loss is the mean square of the misfit as in
the example, divided by the mean square of the measurements, so that its learning rate does not
depend on the unit of length. E is sought in units of the known cells' mean.
"""

import numpy as np

from ..problem import Case, Estimate, Skip

STEPS = 2_500


def fit(case: Case, make_field) -> Estimate:
    """Fit by Adam; make_field(torch, centres) → (parameters, E(), optimizer, scheduler)."""
    if case.kinematics != "small-strain":
        raise Skip("small strain only")
    if case.poisson is None:
        raise Skip("its example fits E alone")
    from importlib.metadata import version

    import torch
    import torchfem

    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    models, unit = _models(case, torch, torchfem)
    measured = [torch.tensor(u / _size(case)) for u in case.displacements]
    x = case.points[case.cells].mean(axis=1)
    parameters, field, optimizer, scheduler = make_field(torch, torch.tensor(x))
    given = torch.tensor(case.is_known if case.forces is None else 0 * case.is_known, dtype=bool)
    known = torch.tensor(np.nan_to_num(case.known[:, 0]) / unit)
    material = _material(case, torchfem)
    for _ in range(STEPS):
        optimizer.zero_grad()
        E = torch.where(given, known, field())
        loss = 0.0
        for model, u in zip(models, measured, strict=True):
            model.material = material(E=E, nu=case.poisson * torch.ones_like(E))
            computed = model.solve(differentiable_parameters=parameters)[0] / _size(case)
            loss = loss + torch.mean((computed - u) ** 2) / len(models)
        loss.backward()
        optimizer.step()
        if scheduler:
            scheduler.step()
    young = unit * torch.where(given, known, field()).detach().numpy()
    return Estimate(young, remarks={"torch-fem": version("torch-fem"), "steps": STEPS})


def _size(case):
    return np.sqrt((case.displacements**2).mean())


def _material(case, torchfem):
    from torchfem import materials

    name = "3D" if case.points.shape[1] == 3 else f"Plane{case.plane.capitalize()}"
    return getattr(materials, f"IsotropicElasticity{name}")


def _models(case, torch, torchfem):
    """A model per trial, and the unit of E."""
    space = case.points.shape[1] == 3
    thickness = {} if space else {"thickness": 1.0 if case.forces is None else 0.1}
    nodes, cells = torch.tensor(case.points), torch.tensor(case.cells)
    E = torch.ones(len(cells))
    models = []
    for trial, u in enumerate(case.displacements):
        material = _material(case, torchfem)(E=E, nu=case.poisson * E)
        model = (torchfem.Solid if space else torchfem.Planar)(nodes, cells, material, **thickness)
        if case.forces is None:
            held = torch.tensor(case.reaction)
            model.displacements[held] = torch.tensor(u)[held]
        else:
            held = torch.tensor(case.clamped)
            model.forces = torch.tensor(case.forces[trial])
        model.constraints[held, :] = True
        models.append(model)
    return models, 1.0 if case.forces is not None else float(np.nanmean(case.known[:, 0]))
