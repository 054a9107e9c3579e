"""The tables and figures of the source documents, rerun in simulation with stated seeds."""
