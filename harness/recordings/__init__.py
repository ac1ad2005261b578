"""Recordings of episodes for the viewer rerun."""

import os

# rerun reads this when it is imported. Otherwise it warns that a recording holds no index.
os.environ.setdefault("RUST_LOG", "error")
