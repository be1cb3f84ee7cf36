"""What operators use: history, notifications, silences, the web page with its API, metrics, exports, reports."""
