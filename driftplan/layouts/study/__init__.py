"""Studies: a scenario of which some things are varied, a cell for every combination. Imports go down this list:

run                             run_study: what is not done yet; StudyResult
answers                         curves, knees, which parameter matters most
executors, worker, cluster      in this process, in others, on a Dask cluster
results                         the file of rows
work                            what is done for a cell
inputs                          what a study names, read and told apart by content
study, schema                   the study file and its cells; what it may say
"""
