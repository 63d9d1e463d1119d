"""Plausibility of 20 random stages, every law, and the size of every effect over the noise."""
import tempfile, time, sys
from pathlib import Path
import numpy as np
import campaigns as C
for n in C.LAWS:
    for s in range(3):
        l = C.Law(np.random.default_rng([s, 77]), n); y = l(C.triangle([0, 1, -1, 1, -1, 1, -1], 400)); v = C.triangle([0, .9, -.3, .3, -.3, .3, -.3, .3], 400); z = l(v)
        up, dn = z[-401:], z[-801:-400][::-1]
        print(f"{n:26s} opening {l.opening:.3f} half-loop {np.abs(up - dn).max() / np.ptp(up):.3f} lags {l.lag} return {abs(y[-1] - y[-801]):.1e} minor {abs(z[-1] - z[-801]):.1e} monotone {bool((np.diff(y[-401:]) < 1e-6).all())}")
with tempfile.TemporaryDirectory() as d:
    for s in range(20):
        a = time.time(); t = C.write(s, (), 1.0, Path(d) / f"h{s}"); a = time.time() - a
        print(f"{s:3d} {t['law']:26s} stroke {t['stroke_m'] * 1e6:5.1f} um opening {t['opening']:.3f} noise {t['noise_m'] / t['stroke_m'] * 100:.3f} % files {[(r['kind'], r['rate_Hz'], r['samples']) for r in t['recordings'].values()]} {a:.2f} s")
    for k in C.kinds():
        out = []
        a = time.time()
        for s in (100, 101, 102):
            e = C.write(s, (k,), 1.0, Path(d) / f"{k}{s}")["effects"][0]; r = [x["rms_over_noise"] for x in e["by_recording"].values()]; p = [x["peak_over_noise"] for x in e["by_recording"].values()]
            out.append("clock" if r[0] is None else f"{max(r):.1f} (peak {max(p):.0f}, {len(e['shown_in'])}/{len(r)})")
        print(f"{k:24s} rms/noise {' | '.join(out)}  {(time.time() - a) / 3:.2f} s", flush=True)
