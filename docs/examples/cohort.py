"""A study: three subjects, one of them broken

`elastoidentify-cohort` makes a map of every subject and a page of all of them; a broken subject
stops no other, and is named. It needs an environment of its own, with `pip install ".[cohort]"`.
How it is called at a shell, which file lies where, and how it runs on a cluster stands on the page
of [many subjects](../cohort.md).

In both maps the tissue is found too stiff and the inclusion too soft; in subject 01 by 2.2 and 1.8
standard errors, though its quality is *good*: ± holds the errors of the displacements only.
"""

import csv
import subprocess
import sys
from pathlib import Path

from elastoidentify.imaging.io import write_image
from elastoidentify.imaging.phantom import make_phantom
from matplotlib import pyplot as plt

true = {
    "01": 2500.0,
    "02": 4000.0,
    "03": 3000.0,
}  # E of the tissue in Pa; inclusions have three times
for subject, young in true.items():
    block = make_phantom(
        pixels=64,
        elements=24,
        tissue_young=young,
        noise=0.01,
        seed=int(subject),
        kinematics="neo-hookean",
    )
    folder = Path("bids", f"sub-{subject}", "elast")
    folder.mkdir(parents=True)
    images = {"acq-rest_elast": block.rest, "dseg": block.segmentation}
    images |= {f"acq-push{k}_elast": image for k, image in enumerate(block.pushed, 1)}
    for name, image in images.items():
        write_image(folder / f"sub-{subject}_{name}.nrrd", image)
broken = Path("bids/sub-03/elast/sub-03_acq-push2_elast.nrrd")
broken.write_bytes(broken.read_bytes()[:2000])  # a copy that was cut short
Path("bids/dataset_description.json").write_text('{"Name": "phantoms", "BIDSVersion": "1.10.0"}')

options = "--known 1:E=5000,nu=0.45 --rigid 4 --rigid 5 --grouping label --method regularized"
options += " --kinematics neo-hookean"
cohort = [sys.executable, "-m", "elastoidentify.cohort.app", "bids", "out"]  # elastoidentify-cohort
done = subprocess.run([*cohort, "participant", "--options", options], capture_output=True)
print(f"exit code {done.returncode}: a subject failed")
subprocess.run([*cohort, "group"], capture_output=True, check=True)

with open("out/group/labels.tsv", encoding="utf-8") as stream:
    rows = list(csv.DictReader(stream, delimiter="\t"))
for row in rows:
    if row["quality"] == "failed":
        print(f"{row['participant_id']}: failed: {row['message'].replace(f'{Path.cwd()}/', '')}")
        continue
    figures = [float(row[f"YoungModulus {name}"]) for name in ("mean", "standard error")]
    truth = true[row["participant_id"][4:]] * {"2": 1, "3": 3}[row["label"]]
    print(
        f"{row['participant_id']}: {row['quality']}: label {row['label']}: "
        "E {:.0f} ± {:.0f} Pa, truth {:.0f}".format(*figures, truth)
    )
    where = f"{row['participant_id']}\nlabel {row['label']}"
    plt.errorbar(where, figures[0], 2 * figures[1], fmt="o", color="C0", capsize=4)
    plt.plot(where, truth, "_", color="k", ms=30)

plt.ylabel("E (Pa): found ± 2 standard errors; bars: truth")
plt.ylim(0)
plt.savefig("cohort.png")
