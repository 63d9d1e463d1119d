"""What leaves the house for tools people own: made of what ships and of the identified plant.

targets.py        names of targets, and what each writes
plant_unit.py     the identified plant as a unit for co-simulation; plant_header.py its numbers
"""
