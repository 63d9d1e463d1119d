"""From recordings of a piezo stage to a calibrated, verified controller.

files -> Recording -> ActuatorModel -> Diagnosis -> Design -> ParameterFile -> Verification

Each arrow is one plain function from frozen records to one frozen record. The floors, lowest
first: errors, provenance | numerics | operators, runtime | records | identification.
"""

__version__ = "0.2.0"
