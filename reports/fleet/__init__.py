"""Summary page of a batch: spread of the parameters, outliers, drift, and failures."""
