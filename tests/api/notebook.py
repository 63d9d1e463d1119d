"""What a newcomer types: a CSV file to a closed loop, with nothing but `import piezoid`."""

import numpy as np
import pandas as pd

import piezoid

frame = pd.read_csv("sweep.csv")
sweep = piezoid.from_frame(frame, name="sweep.csv")
piezoid.plot(sweep).figure.savefig("sweep.png")
model = piezoid.fit(sweep, lab="lab.toml")
piezoid.plot(model).figure.savefig("model.png")
print(model.parameters().head())
found = piezoid.diagnose(sweep, model=model, lab="lab.toml")
piezoid.plot(found).figure.savefig("diagnosis.png")
model = model.extended(found)
check = piezoid.read("check.csv")[0]
print(f"unseen: {model.compare(check).rms_percent:.2f} % of the range")
design = piezoid.design(model, lab="lab.toml")
piezoid.plot(design).figure.savefig("design.png")
time_s = np.arange(8000) / design.axis("x").sampling_rate_Hz
reference_m = model["x"].zero_m + 5e-6 * np.sin(2 * np.pi * 10 * time_s)
loop = piezoid.simulate_loop(model, reference_m, design, lab="lab.toml")
piezoid.plot(loop).figure.savefig("loop.png")
print(f"closed loop: {1e9 * np.std(loop.error[2000:]):.1f} nm rms")
