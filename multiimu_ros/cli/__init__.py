"""The desk tools: `multiimu VERB`, one file per verb."""
