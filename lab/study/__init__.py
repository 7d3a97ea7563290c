"""The report's figures and claims: computed, judged by criteria fixed beforehand, and written down."""
