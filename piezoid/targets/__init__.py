"""What leaves the house for tools people own: made of what ships and of the identified plant.

targets.py        names of targets, and what each writes
exported.py       of what they are made;  box.py  what a box can hold
plant_unit.py     the identified plant as a unit for co-simulation; plant_header.py its numbers
pi_pid.py         settings of a PID with notches;  pid.py  the box;  pid_search.py  its gains
biquad.py         the same as second-order sections;  section_boxes.py, sections.c  the boxes
price.py          what a structure loses beside the exported controller
nanonis.py        sensitivity, limits, hysteresis tables, drift
waveform.py       a predistorted period;  box_loop.py  the plant under whatever a box computes
"""
