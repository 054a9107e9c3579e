"""Scores against a known truth, figures and pages; nothing else imports matplotlib."""
