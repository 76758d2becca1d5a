"""Analysis of results: functions from datasets to datasets."""
