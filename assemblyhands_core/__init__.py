"""Mathematics, data and models of assemblyhands; knows no stage, no Dask, no Hydra."""
