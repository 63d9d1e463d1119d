"""Files for tools and hardware that users own: libraries, co-simulation, PID, Nanonis, waveforms.

Start at targets.py, which has the name and the writer of each target. target_inputs.py defines the
inputs of the writers, among them box.toml. To add a target, write a module like waveform.py and
name its function in targets.py. May import verification, export and everything below them.
"""
