"""Plot the table of `train_lund.py`: ``python examples/curve.py CSV PNG``."""

import csv
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

with Path(sys.argv[1]).open() as file:
    rows = list(csv.DictReader(file))
columns = {name: [float(row[name]) for row in rows] for name in rows[0]}
figure, axes = pyplot.subplots(figsize=(7, 4), layout="constrained")
axes.plot(columns["step"], columns["train_psnr_db"], "C0", label="training photos")
axes.plot(columns["step"], columns["test_psnr_db"], "C1", label="held-out photos")
axes.set(xlabel="step", ylabel="PSNR (dB)")
axes.legend(loc="lower right")
axes.grid(alpha=0.3)
counts = axes.twinx()
counts.plot(columns["step"], [count / 1e3 for count in columns["gaussians"]], "0.6", linestyle=":")
counts.set_ylabel("Gaussians (thousands, dotted)")
figure.savefig(sys.argv[2], dpi=110)
