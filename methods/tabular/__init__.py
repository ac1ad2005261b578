"""Exact solutions of tasks whose model is known (`model`), and versions of methods there.

A method's `fit` hands over to its version. Methods without one, such as `bc`, do the same in all tasks.
"""
