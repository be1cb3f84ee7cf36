"""Proposes what to watch on a robot, and with which bounds: from recordings and from a live robot alike.

One `Signal` (suggestion.py) is filled in step by step: `candidates.py` makes it for what a topic can have and listens
to it, `measured.py` measures, `suggestion.py` derives its settings, `proposal.py` puts all of them together, `nodes.py`
adds nodes, and `thresholds_file.py` writes the file with the evidence. docs/statistics.md has the rules.
"""
