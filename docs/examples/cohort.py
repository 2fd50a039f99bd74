"""A cohort: every subject of a study, and one page of all

Three subjects in the layout of BIDS, one of them with a broken file. The command makes a map of each, says
who failed, and a second call makes the table and the page of the group. It needs the extra `cohort`, and
a minute per subject.
"""

import csv
import subprocess
from pathlib import Path

from elastoidentify.imaging.io import write_image
from elastoidentify.imaging.phantom import Inclusion, make_phantom

for number, contrast in enumerate((2.0, 4.0, 3.0), 1):
    block = make_phantom(
        inclusions=[Inclusion(contrast=contrast)], pixels=80, elements=24, seed=number
    )
    folder = Path(f"study/sub-0{number}/elast")
    folder.mkdir(parents=True)
    name = f"{folder}/sub-0{number}"
    write_image(f"{name}_acq-rest_elast.nii.gz", block.rest)
    write_image(f"{name}_acq-push1_elast.nii.gz", block.pushed[0])
    write_image(f"{name}_acq-push2_elast.nii.gz", block.pushed[1])
    write_image(f"{name}_dseg.nii.gz", block.segmentation)
Path("study/dataset_description.json").write_text('{"Name": "three", "BIDSVersion": "1.10.0"}')
Path("study/sub-03/elast/sub-03_acq-push2_elast.nii.gz").write_bytes(b"not an image")

options = "--known 1:E=5000,nu=0.45 --rigid 4 --rigid 5 --grouping label --edge-length 14"
command = ["elastoidentify-cohort", "study", "out"]
first = subprocess.run([*command, "participant", "--options", options], capture_output=True)
print(f"exit code {first.returncode}: a subject failed")
subprocess.run([*command, "group"], check=True, capture_output=True)
with open("out/group/labels.tsv", encoding="utf-8") as table:
    for row in csv.DictReader(table, delimiter="\t"):
        if row["label"] in ("3", "n/a"):
            print(row["participant_id"], row["quality"], row["Mu mean"], row["unit"], row["message"])
