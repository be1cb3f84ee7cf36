"""Proposes what to watch on a robot, and with which bounds: from recordings and from a live robot alike.

`candidates.py` lists the signals that topics can have, `survey.py` listens to them on any middleware and measures,
`suggestion.py` derives settings, `proposal.py` puts it together, and `thresholds_file.py` writes it with the evidence.
docs/statistics.md has the rules.
"""
