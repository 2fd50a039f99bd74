"""Before anybody is imaged: what would be seen?

A drawing of the block, the pad's stiffness and the pushes that the bench can do are enough to ask
how small a lesion of twice the tissue's stiffness would show, by edge length and by the pushes that
are imaged. On the command line it is `elastoidentify plan`.
"""

import numpy as np
from elastoidentify.imaging.phantom import make_phantom
from elastoidentify.planning import plan
from elastoidentify.study import Study
from matplotlib import pyplot as plt

drawing = make_phantom(inclusions=[], pixels=80, elements=24)  # 120 mm across, pixels of 1.5 mm
study = Study(
    segmentation=drawing.segmentation,
    rigid_labels=drawing.rigid_labels,  # 4: the indenter, 5: the floor
    known_materials=[(1, 5000.0, 0.45)],
    method="regularized",
    noise=0.075,  # mm: the error of a registration, 0.05 of a pixel
)
pushes = [(4, (0, 6, 0)), (4, (4, 4, 0)), (4, (-4, 4, 0))]  # straight, to the right, to the left
seen = plan(study, pushes, tissue=(3000.0, 0.45), edge_lengths=[12.0, 18.0])

sets = list(dict.fromkeys(one.pushes for one in seen))
words = [" + ".join(("straight", "right", "left")[n - 1] for n in one) for one in sets]
for number, length in enumerate((12.0, 18.0)):
    here = [one.typical for one in seen if one.edge_length == length]  # None: not at any size
    for word, size in zip(words, here, strict=True):
        print(f"{length:.0f} mm, {word}: {f'{size:.0f} mm across' if size else 'no size shows'}")
    places = np.arange(len(sets)) + 0.4 * number
    plt.barh(places, [size or 0 for size in here], 0.38, label=f"cells of {length:.0f} mm")

plt.yticks(np.arange(len(sets)) + 0.2, words)
plt.gca().invert_yaxis()
plt.xlabel("smallest lesion that shows at half of the places (mm); no bar: none")
plt.legend()
plt.tight_layout()
plt.savefig("planning.png")
