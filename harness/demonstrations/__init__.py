"""Files of demonstrations: read from several forms, fitted to a task, described and written.

`reading.read` is the way in. `apart` reads a file in a process of its own, by a module for each form, and
`units` scales its actions.
"""
