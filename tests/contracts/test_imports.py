"""The import graph, including imports inside functions, has no cycles."""

from graphlib import TopologicalSorter

import grimp

PACKAGES = ("piezoid", "piezoid_cli", "piezoid_reports", "piezoid_datasets")


def test_no_modules_import_each_other_in_a_circle():
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert len(imports) > 200
    TopologicalSorter(imports).prepare()  # a CycleError names the cycle
