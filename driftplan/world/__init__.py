"""Geometry: maps and files. No OMPL, no beacons.

world, inflation                World: where a disc-shaped robot can drive, what it can see
zones, zone_files               floors with odometry of their own
mapfiles                        load_world, save_world, and the formats: ros_map, movingai_map, geojson_map
cells, cell_pictures            from cells to polygons and back; a YAML file and the picture it names
trajectories                    paths and trajectories in files
odometry_logs, log_tables       recordings: TUM, KITTI, MR.CLAM, CSV, MATLAB
noise_files                     a noise as YAML
shapes                          polygons as public functions accept them
"""
