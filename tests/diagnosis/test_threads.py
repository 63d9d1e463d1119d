"""A diagnosis by many threads is the diagnosis by one."""

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import recorded


def test_a_diagnosis_is_the_same_byte_for_byte_however_many_threads_make_it() -> None:
    recordings, lab = recorded(draw_campaign(31, effects=("lag",), plans=("rates",)))
    alone, said = diagnose(recordings, lab=lab), set()
    together = diagnose(recordings, lab=lab, threads=3, progress=said.add)
    assert write_diagnosis(together) == write_diagnosis(alone)
    assert {"testing lag", "comparing lag with confounded effects"} <= said
