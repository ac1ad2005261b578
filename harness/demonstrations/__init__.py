"""Files of demonstrations: read from several forms, fitted to a task, described and written.

`reading.read` is the way in. `apart` has `forms` read a file in a process of its own, and `units` scales its
actions.
"""
