"""torch-fem, E as a neural field, by Adam."""

from . import _torch_fem

TITLE = "torch-fem, neural field"
SOURCE = (
    'its example "property fields", neural field: two hidden layers of 100, tanh, softplus; 2 '
    "500 steps of Adam, rate 0.01, halved every 1 000. Its lower bound E > 1 is that "
    "example's own knowledge and kept there only"
)
PYTHON = "ELASTOIDENTIFY_TORCH_FEM_PYTHON"


def estimate(case):
    bound = 1.0 if case.forces is not None else 0.0
    size = abs(case.points).max()

    def field(torch, centres):
        torch.manual_seed(0)
        layers = [torch.nn.Linear(a, b) for a, b in ((centres.shape[1], 100), (100, 100), (100, 1))]
        net = torch.nn.Sequential(
            layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2], torch.nn.Softplus()
        )
        optimizer = torch.optim.Adam(net.parameters(), lr=0.01)
        scheduler = torch.optim.lr_scheduler.StepLR(optimizer, step_size=1000, gamma=0.5)
        places = centres * (2.0 / size if case.forces is None else 1.0)
        return tuple(net.parameters()), lambda: net(places).squeeze() + bound, optimizer, scheduler

    return _torch_fem.fit(case, field)
