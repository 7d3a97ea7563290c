"""Is the log of a robot fit for a diagnosis? What was understood of each joint, and what is wrong with its channels."""
