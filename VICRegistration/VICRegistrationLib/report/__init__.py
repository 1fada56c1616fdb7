"""Pictures of fitted surfaces and the report of a fit on one page."""
