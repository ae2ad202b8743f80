"""Requirements of each port as tests: a test's docstring is the requirement, and is shown with its failure.

A test module imports all of ``device`` and of its port's suite, and lists its drivers in ``CASES``.
"""
