"""What evaluations, studies and pages of logs share.

* :mod:`~surefoot.experiments.study.store`: a :class:`Case` is a function that returns rows, and the code that
it
  depends on; a :class:`Store` keeps the result of each on the disk.
* :mod:`~surefoot.experiments.study.runner`: a :class:`Runner` runs the cases that a store lacks, in this
process, in
  several, or on another backend of joblib; a case that fails is kept as such.
* :mod:`~surefoot.experiments.study.tables`: tables, declared by their columns; ``statistics``, ``figures``,
``page``.

Studies of many seeds are scripts in ``benchmarks`` over ``benchmarks/bench.py``.
"""
