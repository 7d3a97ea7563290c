"""What is fitted: the compared signals and the parameter vector of a structure."""
