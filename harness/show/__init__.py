"""From rows and rollouts to pages, figures and recordings."""

import os

# rerun reads it when imported; it would warn of each recording that it holds no index.
os.environ.setdefault("RUST_LOG", "error")
