"""What each port demands, as tests: a test's docstring is the demand, and is told with its failure.

A test module imports all of ``device`` and of its port's suite, and names its drivers in ``CASES``.
"""
