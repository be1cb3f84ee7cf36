"""The same thresholds for other systems: alerting rules of Prometheus, a dashboard of Grafana."""
