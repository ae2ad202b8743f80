"""A simulated KUKA controller: KRL modules from a folder, variables over KUKAVARPROXY, a tool that moves."""
