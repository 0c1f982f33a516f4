"""Geometry: maps and files. No OMPL, no beacons.

world, inflation                World: where a disc-shaped robot can drive, what it can see
prepared_area                   an area that several threads may ask at once
zones, zone_grid, zone_files    floors with odometry of their own, quick to find among many
formats                         what a name tells of a file; places as files know them
mapfiles                        load_world, save_world; formats: ros_map, movingai_map, geojson_map, imdf_map,
                                building_map, dxf_map
route_graphs, lif               nodes and edges of nav2, of fleets and of buildings, there and back
cells, cell_pictures            from cells to polygons and back; a YAML file and the picture it names
plain_data                      YAML and JSON from anybody
route_files                     routes as ROS has them: paths, poses, waypoints
trajectories                    paths and trajectories in files
odometry_logs, log_tables       recordings: TUM, KITTI, MR.CLAM, CSV, MATLAB
log_formats                     and ROS bags, CARMEN, g2o
log_order, log_plausibility     rows in the order of their times; do headings follow the way driven
noise_files, ros_covariances    a noise as YAML; what it means for messages of ROS
shapes                          polygons as public functions accept them
"""
