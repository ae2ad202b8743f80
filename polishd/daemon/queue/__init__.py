"""The queue of jobs and the requests that change it."""
