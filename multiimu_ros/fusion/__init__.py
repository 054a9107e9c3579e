"""N registered IMUs to one."""
