"""What a newcomer types: a CSV file to a closed loop, with nothing but `import piezoid`."""

import numpy as np
import pandas as pd

import piezoid

frame = pd.read_csv("sweep.csv")
sweep = piezoid.Recording.from_frame(frame, name="sweep.csv")
sweep.plot().figure.savefig("sweep.png")
model = piezoid.fit(sweep, lab="lab.toml")
model.plot().figure.savefig("model.png")
print(model.parameters().head())
found = piezoid.diagnose(sweep, model=model, lab="lab.toml")
found.plot().figure.savefig("diagnosis.png")
model = model.extended(found)
check = piezoid.read("check.csv")[0]
print(f"unseen: {model.compare(check).rms_percent:.2f} % of the range")
design = piezoid.design(model, lab="lab.toml")
design.plot().figure.savefig("design.png")
time_s = np.arange(8000) / design.axis("x").sampling_rate_Hz
reference_m = model["x"].zero_m + 5e-6 * np.sin(2 * np.pi * 10 * time_s)
loop = model.simulate_loop(reference_m, design, lab="lab.toml")
loop.plot().figure.savefig("loop.png")
print(f"closed loop: {1e9 * np.std(loop.error[2000:]):.1f} nm rms")
