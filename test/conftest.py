"""Environment of all tests, set before numpy, rclpy, numba or rerun is first imported."""

import itertools
import os
import runpy
import sys
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from compile_kernels import compile_each_kernel_once

import softrobot_twin  # noqa: F401  chooses threads; before numpy

# Tests start hundreds of processes, each of which would compile all sources anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# With this, rclpy checks the types of message fields; otherwise wrong types are sent as garbage.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
# A wrong shape is an error, not a warning.
os.environ["RERUN_STRICT"] = "1"


# What this package asks of other libraries: each call at least once, and each kernel compiled.
# These tests are marked `libraries`, and the oldest versions run them alone: what is calculated
# with the answers of the libraries no version changes, and it is tested on the newest.
# A name is a whole file but for its slow tests, or one test of it.
LIBRARIES = {
    "": (
        "layering::test_only_an_open_view_loads_rerun_and_only_a_picture_matplotlib",
        "library_names", "package::test_every_library_that_is_imported_is_declared",
        "traced_stage::test_the_second_of_two_equal_traces_is_run_by_the_driver",
        "traced_stage::test_a_kernel_that_returns_something_else_sends_the_stage_back_to_python",
        "traced_stage::test_a_kernel_whose_arguments_numba_converts_stays_in_python",
    ),
    "command_line": ("command_line::test_bash_completes_commands_options_and_files",),
    "constraints": (
        "cable", "cavity", "effector", "reduced_cavities", "row_stack",
        "contact_curvature::test_a_facet_along_a_straight_side_is_not_infinitely_stiff",
        "contact_curvature::"
        "test_stiffness_is_minus_force_times_the_gaps_curvature_or_its_definite_part",
    ),
    "control": (
        "marker_input", "pose_input", "stiffness_input", "target_input", "target_path",
        "touch_input", "hinge_motors", "pulley_angles",
        "simulated_device::test_noise_has_the_given_deviation_and_repeats_for_a_seed",
        "target_correction",
    ),
    "geometry": (
        "box_mesh", "box_pairs::test_a_tilted_cube_stands_on_its_lowest_edge", "cad_meshing",
        "cell_patches", "closest_features", "cubic_bubbles", "helix",
        "closed_surface::test_a_ball_touches_a_table_by_its_face_edge_and_corner_alone",
        "closed_surface::test_all_contact_normals_on_a_flat_floor_equal_its_normal",
        "hexahedral_mesh", "mass_properties", "mesh_parts", "mesh_reading", "mesh_repair",
        "mid_edge_nodes", "point_location", "quadratic", "quality", "regions", "round_axes",
        "self_proximity::test_the_ends_of_a_c_shape_meet_face_to_face", "surface",
        "surface_reading", "tet_mesh", "uniform_refinement", "wall_thickness",
        "diamond_meshes", "finger_meshes",
    ),
    "mechanics": (
        "beam_sections", "cubic_correction", "gravity", "hinged_frames", "hyperelastic_laws",
        "inertia", "kinematics", "mass_damping", "material", "polar", "rigid_inertia",
        "reduced_elements::test_sampled_points_store_the_same_energy_in_a_rotated_state",
        "small_displacement",
        "springs/slopes::test_so_it_is_where_rates_are_taken_from_a_reference",
        "strain_rate_damping", "touch_loads",
    ),
    "record": ("replay::test_a_replay_gives_all_bits_of_the_run_again", "run_values"),
    "ros": (
        "device_node::test_it_measures_lengths_markers_and_effectors_with_one_stamp", "messages",
        "parameter_table", "pulleys",
        "pressures::test_pressures_are_published_absolute_with_the_stamp_of_all_actuators",
        "run_recording::test_hostile_messages_of_every_kind_are_replayed_to_the_bit", "scene_file",
        "status", "target_node::test_a_table_of_commands_is_played_over_and_over_and_no_targets",
        "target_stiffness", "topic_table", "touches", "transforms", "twin_node",
        "twin_services::test_a_view_can_be_recorded", "visualization",
    ),
    "scene": ("body_entries", "entry", "law_constants", "loading", "mesh_entries", "patterns"),
    "scripting": ("building", "gym_environment", "named_commands", "robot", "run_table", "vector_environment"),
    "simulation": (
        "apparent_compliance::test_a_body_reduced_to_vertebrae",
        "apparent_compliance::test_a_contact_that_presses_holds_its_gap",
        "apparent_compliance::test_with_friction_a_small_push_lets_the_cables_stick",
        "apparent_stiffness", "beam_masses", "beams", "cavities",
        "compiled_early::test_the_first_contact_of_every_pair_compiles_nothing",
        "compiled_early::test_fallback_solvers_are_compiled_before_the_first_step",
        "elastic_cables", "element_kinds", "factorizations", "full_model_error", "hinges",
        "hyperelastic_newton::test_each_linearization_squares_the_error[ogden-quadratic]",
        "mass_springs",
        "orientation::test_the_tip_of_a_trunk_points_aside_within_a_hundredth_of_a_degree",
        "reduced_cavities", "reduced_contact",
        "rubber_memory::test_a_restored_state_goes_on_to_the_bit_and_a_reset_is_new_material",
        "self_contact", "skins", "slides", "springs", "state", "stiffness_targets", "touches",
        "volume_patches", "warm_up",
    ),
    "solvers": (
        "contact_active_set", "contact_continuation", "dense_stiffness",
        "direct_problem", "force_bounds", "inverse_problem", "inverse_solver",
        "polyhedron_projection", "quadratic_program", "superlu", "multifrontal/condensation",
        "multifrontal/definiteness",
    ),
    "study": (
        "bench::test_bench_writes_a_row_for_each_stage_and_a_picture",
        "body_training::test_the_file_says_how_it_was_made", "controller_export",
        "live_line",
        "meshing::test_the_size_is_searched_for_a_step_time", "outputs", "progress",
        "reduction_basis", "reduction_states", "richardson", "run_summary",
        "run_plot::test_the_legend_of_many_cables_names_the_largest_and_overlaps_nothing",
        "run_plot::test_tables_of_commands_and_samples_of_a_workspace_are_drawn",
        "scene_picture::test_states_side_by_side_make_a_wider_picture",
        "scene_picture::test_springs_are_drawn_between_their_ends",
        "scene_picture::test_the_legend_names_all_that_a_scene_has_and_nothing_else",
        "simulate::test_a_run_has_the_stated_columns_and_a_row_for_each_target", "stiffness",
        "tracking_report",
        "workspace::test_a_cluster_computes_the_same_and_a_failure_costs_only_its_sample",
        "workspace::test_two_processes_write_the_same_bytes",
        "workspace::test_the_picture_has_its_size",
    ),
    "view": (
        "blueprint", "frame", "mirror", "picture", "recent_path", "simulation_frames",
        "surface_normals", "tension_colours", "viewer",
    ),
}  # fmt: skip


# `make test-all` runs all tests. `make test` leaves out, as `exhaustive`, those that are marked
# `slow` and not named in `KEPT`, those of `LONG`, most cases of `SAMPLED`, and most seeds. What it
# leaves out are long runs, finer meshes, other robots, studies and pictures: a shorter test holds
# each of them to the same bar, or the change that would break them breaks tests of its parts. What
# keeps a command safe is in `KEPT`.
KEPT = {
    "": ("readme::test_its_python_runs_and_brings_the_tip_to_the_target",),
    "control": (
        "closed_loop::test_the_closed_loop_cuts_the_mean_error_to_a_fifth",
        "hostile_input::test_long_runs_of_random_inputs_lead_to_no_unsafe_command", "trunk",
    ),
    "ros": (
        "demo::test_ctrl_c_ends_all_three_processes_and_writes_the_report",
        "demo::test_the_demo_leads_the_robot[diamond]",
        "hostile_messages",
    ),
    "scripting": ("python_page",),
    "simulation": (
        "balloon::test_pressure_control_stops_at_the_limit_point_and_says_so",
        "edge_of_reach::test_at_targets_ten_times_too_far_lengths_rest_and_home_is_reached",
        "hostile_cavities",
        "inverse_trunk::test_the_path_between_the_cylinders_crosses_neither_and_would_without_contact",
    ),
    "view": ("live_viewer::test_a_frozen_viewer_of_an_ordinary_robot_has_no_effect",),
}  # fmt: skip
# Not slow by themselves, but together.
LONG = {
    "": (
        "kernel_cache::test_a_source_that_changes_in_a_run_is_not_that_of_its_kernels",
        "kernel_cache::test_another_checkout_of_the_same_sources_compiles_nothing",
        "kernel_cache::test_entries_that_nobody_used_for_a_week_are_deleted",
        "kernel_cache::test_processes_that_compile_at_once_agree_and_keep_one_entry_each",
        "kernel_cache::"
        "test_the_environment_names_the_folder_and_one_that_cannot_be_written_is_replaced",
    ),
    "control": (
        "force_observer::"
        "test_a_push_at_a_known_place_is_found_with_an_outlier_and_two_lost_markers",
        "mesh_error_watch::"
        "test_a_state_is_asked_about_once_and_then_the_process_gives_its_memory_back",
        "mesh_error_watch::"
        "test_the_process_estimates_the_error_that_the_simulation_does_then_tells_what_failed",
        "reduction_error_watch::"
        "test_the_process_tells_the_error_that_the_full_model_has_then_what_failed",
    ),
    "docs": ("site::test_every_page_of_docs_is_in_the_site",),
    "examples": (
        "examples::test_a_camera_cuts_the_error_of_the_finger_to_less_than_a_half",
        "examples::test_a_policy_learned_on_many_reduced_robots_serves_the_full_model_and_the_device",
        "examples::test_a_policy_learns_within_a_few_generations",
        "examples::test_calibration_finds_the_modulus_of_the_real_finger",
        "examples::test_the_gripper_lifts_the_ball_with_its_palm",
        "examples::test_the_trunk_follows_its_path_while_the_cylinders_carry_it",
    ),
    "geometry": (
        "pneumatic_meshes::test_the_script_makes_the_committed_mesh",
        "shapes::test_mass_properties_are_the_limit_of_those_of_its_surface",
    ),
    "mechanics": (
        "fold_barrier::test_a_move_is_allowed_as_far_as_all_values_keep_a_share_of_themselves",
        "fold_barrier::test_the_barrier_acts_where_a_value_is_small_and_none_is_not_positive",
    ),
    "ros": (
        "clocks::test_ticks_are_counted_on_simulated_time",
        "demo::test_the_start_is_waited_for_as_long_as_a_node_tells_of_its_progress",
        "trunk::test_the_tip_follows_the_demo_s_path_between_the_cylinders",
        "twin_diagnostics::test_the_error_of_the_mesh_is_reported_once_it_is_estimated",
        "twin_diagnostics::test_the_errors_of_a_reduced_body_are_reported",
    ),
    "scripting": (
        "robot::test_a_copy_in_contact_goes_on_from_the_efforts_of_the_original",
        "robot::test_a_picture_is_written_or_returned",
    ),
    "simulation": (
        "beam_masses::test_the_scheme_of_second_order_is_one_for_a_tumbling_beam",
        "beams::test_the_sway_of_a_portal_has_the_frequency_of_its_dynamic_stiffness",
        "compressed::"
        "test_shortening_of_the_trunk_lies_between_that_of_its_full_section_and_its_core",
        "contact_rest::test_a_beam_beside_a_rod_comes_to_rest_with_ten_drawn_shortenings",
        "edge_of_reach::"
        "test_a_beam_of_eight_cables_beside_a_rod_comes_to_rest_at_targets_too_far",
        "exploration::test_a_robot_that_shall_not_explore_rests_where_it_is",
        "fibres::test_a_braided_tube_contracts_as_inextensible_threads_make_it",
        "fibres::test_hoops_stop_radial_growth_and_are_slack_where_the_tube_contracts",
        "generalized_alpha::test_a_mass_on_a_spring_converges_at_the_order_of_its_scheme",
        "generalized_alpha::test_rotations_converge_at_the_order_of_the_scheme",
        "inverse_limits::"
        "test_a_target_ten_times_out_of_reach_is_held_without_drift_beside_a_rod",
        "mesh_error::test_on_bars_the_estimate_is_within_a_factor_of_the_truth",
        "mesh_error::"
        "test_the_error_at_given_pressures_and_volumes_is_near_that_against_a_finer_mesh",
        "mounting::test_two_hundred_reachable_poses_are_reached",
        "pneumatic_robots::test_a_grown_accordion_returns_after_a_push_to_the_side",
        "reduced_body::test_a_basis_that_spans_everything_gives_the_full_model",
        "sag::test_thin_rubber_has_the_sag_of_the_simulation",
        "snap_through::test_an_undamped_spring_truss_snaps_through_below_its_limit_load",
        "trunk_scene::test_a_trunk_pulled_against_a_cylinder_presses_on_it",
        "trunk_scene::test_without_contact_the_body_crosses_both_cylinders",
        "viscous_motion::test_the_error_of_a_damped_trunk_is_of_the_order_of_its_time_step",
    ),
    "solvers": ("multifrontal/cholesky::test_bodies_of_thousands_of_nodes_are_solved",),
    "study": (
        "accuracy::test_choose_studies_a_refined_mesh_and_keeps_its_files",
        "accuracy::"
        "test_choose_tells_what_a_training_costs_and_buys_and_trains_where_it_is_asked_to",
        "accuracy::test_errors_fall_with_refinement_and_quadratic_meshes_are_better",
        "accuracy::test_every_reference_states_its_uncertainty",
        "accuracy::"
        "test_prescribed_displacements_have_smaller_errors_than_forces_on_the_coarsest_mesh",
        "bench::test_a_reduced_model_alone_is_timed",
        "bench::test_a_reduced_model_is_compared_with_its_full_one",
        "body_training::test_a_stopped_run_goes_on_where_it_was",
        "body_training::test_two_processes_train_the_same",
        "cavity_files::test_a_picture_shows_walls_of_all_cavities_inside_clear_bodies",
        "cavity_files::test_a_run_of_commands_writes_pressures_and_a_picture",
        "design::test_a_search_that_stops_at_a_kink_says_so_and_a_radius_takes_kinks_away",
        "design::test_trials_with_an_actuator_at_its_limit_are_refused_and_told",
        "explain::test_every_scene_of_the_package_is_explained",
        "hexahedral_accuracy",
        "inflated_accuracy::test_choose_speaks_of_volumes_and_keeps_what_the_scene_controls",
        "inflated_accuracy::test_errors_at_given_volumes_and_pressures_fall_with_the_mesh",
        "interval_targets::test_the_trunk_is_in_contact_during_the_whole_timed_interval",
        "meshing::test_the_size_is_searched_for_a_step_time",
        "reduction_along::test_a_body_trained_along_a_path_keeps_its_gap_and_presses_as_the_full_one",
        "run_plot::test_the_command_writes_a_picture_beside_the_run",
        "scene_picture::test_no_text_of_a_labelled_picture_is_clipped_or_overlaps_another",
        "scene_picture::test_states_side_by_side_make_a_wider_picture",
        "scene_picture::test_the_legend_names_all_that_a_scene_has_and_nothing_else",
        "tracking_report::test_no_text_of_the_picture_is_clipped_or_overlaps_another",
        "tracking_report::test_the_picture_of_one_run_or_two_is_drawn",
        "vertebrae_reduction::test_cables_run_through_vertebrae",
        "vertebrae_reduction::test_the_command_makes_only_what_has_changed",
        "vertebrae_reduction::test_the_fetch_is_divided_into_plates_and_accordions",
        "vertebrae_reduction::test_the_measured_error_is_saved",
        "vertebrae_reduction::test_vertebrae_that_do_not_fit_are_refused",
        "vertebrae_reduction::test_weight_is_that_of_the_body",
        "workspace::test_a_lost_process_costs_only_its_own_sample",
        "workspace::test_a_stopped_run_goes_on_where_it_was",
        "workspace::test_two_processes_write_the_same_bytes",
    ),
    "tools": (
        "compare_inverse::test_a_bar_that_snaps_rests_where_its_tip_is_nearest",
        "compare_inverse::test_a_beam_that_kept_out_of_balance_for_ever_comes_to_rest",
        "compare_inverse::test_random_robots_rest_near_the_best_place_or_tell_it",
        "contact_growth::test_more_contacts_make_more_rows_on_the_same_matrix",
    ),
}  # fmt: skip
# Of tests with many cases, `make test` takes one in three.
SAMPLED = {
    "": (
        "kernel_cache::test_a_change_compiles_the_kernels_that_import_it_and_no_others",
        "traced_stage::test_the_driver_gives_the_same_bits_as_python",
    ),
    "control": (
        "closed_loop::test_a_late_robot_does_not_overshoot_and_its_cables_rest",
        "closed_loop::test_a_robot_that_acts_late_is_where_its_moving_target_is",
        "closed_loop::test_a_target_that_stops_is_overshot_by_its_way_of_the_delay_at_most",
        "device_returns::test_a_device_that_returns_at_another_position_is_resynchronised",
    ),
    "examples": ("hardware::test_the_nodes_tell_what_they_take",),
    "geometry": (
        "surface_shape::test_in_overlap_a_contact_point_is_at_least_as_deep_as_any_point",
        "surface_shape::test_no_point_of_a_triangle_is_nearer_than_its_contact_point",
    ),
    "mechanics": (
        "point_law::test_forces_and_stiffness_are_the_slopes_of_the_energy",
    ),
    "ros": (
        "hostile_messages::test_no_message_ends_a_device",
        "hostile_messages::test_no_message_ends_a_twin_or_causes_an_unsafe_command",
        "hostile_messages::test_ticks_between_random_messages_are_as_safe",
    ),
    "scene": (
        "loading::test_a_text_too_large_for_a_scene_is_refused_before_it_is_read_whole",
        "mutated_scenes",
    ),
    "simulation": (
        "collapse::test_a_collapsed_body_recovers_or_is_reported_as_inverted",
        "collapse::test_in_dynamics_a_collapsed_body_recovers_or_is_reported_as_inverted",
        "compressed::test_a_trunk_crushed_by_its_cables_is_reported",
        "edge_of_reach::test_at_targets_ten_times_too_far_lengths_rest_and_home_is_reached",
        "edge_of_reach::test_the_diamond_comes_to_rest_at_targets_ten_times_too_far_and_returns",
        "fallback::test_the_better_model_is_in_use_while_the_error_is_above_the_wanted_one",
        "generalized_alpha::test_a_beam_converges_at_the_second_order",
        "guessed_actuation::test_by_one_kernel_a_robot_goes_the_same_way_to_the_bit",
        "inverse_obstacles::test_a_beam_between_two_rods_crosses_neither",
        "model_file::test_a_file_that_was_cut_or_whose_bits_changed_is_refused",
        "model_file::test_each_array_is_refused_missing_in_another_shape_or_of_another_kind",
        "model_file::test_each_array_of_numbers_is_refused_with_a_number_that_is_none",
        "model_file::test_what_does_not_fit_the_body_is_refused",
        "obstacles::test_a_soft_block_lies_on_an_obstacle",
        "rubber_stays_upright::test_a_cube_stays_upright_in_one_command",
        "scales::test_a_similar_robot_gives_a_similar_result",
        "sensitivities::test_derivatives_are_those_of_states_that_are_solved_again",
        "statics_from_rest::"
        "test_a_soft_bar_that_was_straight_sags_to_where_a_stiff_one_sags_as_it_softens",
        "stiffness_targets::test_the_pad_shows_the_wanted_stiffness_and_stays_where_it_is",
        "triangulated_floor",
        "trunk_scene::test_the_tip_reaches_the_published_workspace",
        "tunnelling::test_no_body_passes_through_a_wire_of_a_millimetre",
        "wedge",
    ),
    "study": (
        "bench_reference::test_a_step_makes_no_more_calls_than_in_the_reference",
        "first_scene",
        "pneumatic_warnings::test_threads_that_are_further_apart_than_two_walls_are_warned_of",
    ),
    "tools": ("robot_references", "rubber_references"),
}  # fmt: skip
# Of a test with more seeds than these, `make test` takes the first.
SEEDS = 5


@cache
def tests_of(table: str) -> dict[Path, set[str]]:
    """Files of a table, and the names of their tests; none stands for a whole file."""
    found, folder = {}, Path(__file__).parent
    for room, entries in globals()[table].items():
        for entry in entries:
            file, _, test = entry.partition("::")
            path = folder / room / file
            path = path.with_name(f"test_{path.name}.py")
            if not path.exists():
                # The simulation's tests have rooms below it, too.
                path = next((folder / room).glob(f"*/{path.name}"), path)
            found.setdefault(path, set()).update({test} - {""})
    return found


def is_exhaustive(item, own: set[str], drawn: Counter) -> bool:
    """Whether `make test` leaves a test out.

    Args:
        item: The test.
        own: Its names.
        drawn: Cases so far of each test, and of each of its cases but for the seed; is changed.
    """
    # `callspec.indices` number the cases where parameters are stacked, and not each parameter.
    values = item.callspec.params if hasattr(item, "callspec") else {}
    places = {name: id(value) for name, value in values.items()}
    same = (item.path, item.originalname)
    if places.pop("seed", None) is not None:
        drawn[*same, *places.items()] += 1
        if drawn[*same, *places.items()] > SEEDS:
            return True
    kept, long, sampled = (
        own & names if names else names is not None
        for names in (tests_of(table).get(item.path) for table in ("KEPT", "LONG", "SAMPLED"))
    )
    drawn[same] += 1
    if long or (sampled and drawn[same] % 3 != 1):
        return True
    return item.get_closest_marker("slow") is not None and not kept


def only_libraries(config) -> bool:
    return config.option.markexpr == "libraries"


def pytest_ignore_collect(collection_path, config):
    """With -m libraries, files without such tests are not even read."""
    is_test = collection_path.name.startswith("test_") and collection_path.suffix == ".py"
    is_other = is_test and collection_path not in tests_of("LIBRARIES")
    return True if only_libraries(config) and is_other else None


def pytest_collection_modifyitems(config, items):
    """Marks the tests of the tables; one of `LIBRARIES` that is nowhere is an error."""
    wanted = tests_of("LIBRARIES")
    missing = {(path, "") for path in wanted if not path.is_file()}
    missing |= {(path, name) for path in {item.path for item in items}
                for name in wanted.get(path, ())}  # fmt: skip
    drawn = Counter()
    for item in items:
        own = {item.name, item.originalname}
        if is_exhaustive(item, own, drawn):
            item.add_marker(pytest.mark.exhaustive)
        names = wanted.get(item.path)
        if names is None:
            continue
        if own & names if names else item.get_closest_marker("slow") is None:
            item.add_marker(pytest.mark.libraries)
            missing -= {(item.path, name) for name in own}
    if only_libraries(config) and missing:
        raise pytest.UsageError(f"conftest.LIBRARIES names what is not there: {sorted(missing)}")


if "PYTEST_XDIST_WORKER" in os.environ:
    compile_each_kernel_once()


def domains_in_turn() -> Callable[[], int]:
    """Yields ROS domains 1 to 100, starting at a different one in each test process.

    A node that was killed stays in the graph of its domain for a while; when the turn comes to
    that domain again, it is long forgotten.
    """
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    turns = itertools.count(os.getpid() + 50 * worker)
    return lambda: 1 + next(turns) % 100


next_domain = domains_in_turn()


@pytest.fixture(scope="session")
def ros_domain() -> Callable:
    """Makes contexts that hold a ROS domain which no other test on this machine uses meanwhile."""
    from domain_coordinator import domain_id

    return lambda: domain_id(next_domain)


@pytest.fixture
def ros_domain_id(ros_domain):
    """A ROS domain that no other test on this machine uses at the same time."""
    with ros_domain() as number:
        yield number


@pytest.fixture(scope="session")
def block() -> Callable:
    """Makes a box of cells, six tetrahedra each, with its inner nodes moved about."""

    import numpy as np

    from softrobot_twin.geometry.tet_mesh import TetMesh

    def make(size=(0.2, 0.3, 0.4), cells=(2, 3, 4), shake=0.2) -> TetMesh:
        counts = np.array(cells) + 1
        grid = np.array(list(itertools.product(*(range(count) for count in counts))), float)
        inner = ((grid > 0) & (grid < counts - 1)).all(axis=1)
        grid[inner] += np.random.default_rng(1).uniform(-shake, shake, (inner.sum(), 3))
        index = np.arange(len(grid)).reshape(counts)
        tets = []
        for cell in itertools.product(*(range(count) for count in cells)):
            for path in itertools.permutations(range(3)):
                corner = np.array(cell)
                tet = [index[tuple(corner)]]
                for axis in path:
                    corner[axis] += 1
                    tet.append(index[tuple(corner)])
                # Odd permutations give mirrored tetrahedra, so two nodes are swapped.
                even = np.linalg.det(np.eye(3)[list(path)]) > 0
                tets.append(tet if even else [tet[0], tet[2], tet[1], tet[3]])
        return TetMesh(grid * np.array(size) / np.array(cells), np.array(tets))

    return make


_COLUMN_SCENE = """
name: column
gravity: [0.0, 0.0, -9.81]
body:
  mesh: {file: column.vtk}
  element: linear
  material: {law: corotational, young_modulus: 200.0e3, poisson_ratio: 0.4, density: 1070.0}
  fixed:
    - box: {minimum: [-1.0, -1.0, -0.001], maximum: [1.0, 1.0, 0.001]}
cables:
"""
_COLUMN_CABLE = """
  - name: %s
    pull_point: [%s, %s, -0.02]
    points: [[%s, %s, 0.05], [%s, %s, 0.10]]
    shortening: [0.0, 0.02]
    tension: [0.0, 10.0]
"""
_COLUMN_EFFECTOR = """
effectors:
  - name: tip
    points: [[0.01, 0.01, 0.10]]
"""


@pytest.fixture(scope="session")
def column(tmp_path_factory, block) -> Path:
    """Scene file of a column, 20 × 20 × 100 mm, held at its foot."""
    import meshio

    folder = tmp_path_factory.mktemp("scene")
    mesh = block(size=(0.02, 0.02, 0.1), cells=(2, 2, 5), shake=0.0)
    meshio.Mesh(mesh.node_positions, [("tetra", mesh.cells)]).write(folder / "column.vtk")
    corners = {"a": (0.0, 0.0), "b": (0.02, 0.0), "c": (0.02, 0.02), "d": (0.0, 0.02)}
    cables = "".join(_COLUMN_CABLE % (name, *3 * corner) for name, corner in corners.items())
    scene = folder / "column.yaml"
    scene.write_text(_COLUMN_SCENE + cables + _COLUMN_EFFECTOR)
    return scene


@pytest.fixture(scope="session")
def air_scene(block, tmp_path_factory) -> dict:
    """An upright soft block with three cavities and a cable.

    `low` and `high` are commanded by pressure, `high` may be evacuated; `syringe` is commanded by
    volume.
    """
    import meshio
    import numpy as np

    from softrobot_twin.geometry.surface import boundary_triangles

    folder = tmp_path_factory.mktemp("air")
    cells, size = (4, 4, 10), (0.02, 0.02, 0.1)
    mesh = block(size, cells, 0.0)
    middle = mesh.node_positions[mesh.cells].mean(axis=1) * cells / size
    across = (np.abs(middle[:, :2] - 2.0) < 1.0).all(axis=1)
    hollow = np.zeros(len(mesh.cells), bool)
    for name, foot in (("low", 1.0), ("high", 4.0), ("syringe", 7.0)):
        inside = across & (middle[:, 2] > foot) & (middle[:, 2] < foot + 2.0)
        triangles = boundary_triangles(mesh.cells[inside])
        points = meshio.Mesh(mesh.node_positions, [("triangle", triangles)])
        meshio.write(folder / f"{name}.vtk", points)
        hollow |= inside
    used, index = np.unique(mesh.cells[~hollow], return_inverse=True)
    body = meshio.Mesh(mesh.node_positions[used], [("tetra", index.reshape(-1, 4))])
    meshio.write(folder / "body.vtk", body)

    def cavity(name, **entries) -> dict:
        return {"name": name, "walls": [{"file": str(folder / f"{name}.vtk")}], **entries}

    return {
        "name": "air",
        "gravity": [0.0, 0.0, -9.81],
        "body": {
            "mesh": {"file": str(folder / "body.vtk")}, "element": "linear",
            "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-6]}}],
        },
        "cavities": [
            cavity("low", pressure=[0.0, 2.0e4], rate=2.0e4),
            cavity("high", pressure=[-5.0e3, 1.0e4], rate=1.0e4),
            cavity("syringe", control="volume", growth=[-4.0e-7, 1.0e-6], rate=1.0e-6),
        ],
        "cables": [{
            "name": "east", "pull_point": [0.02, 0.01, 0.0], "points": [[0.02, 0.01, 0.1]],
            "shortening": [0.0, 0.01], "rate": 0.02, "tension": [0.0, 10.0],
        }],
        "effectors": [{"name": "top", "points": [[0.01, 0.01, 0.1]], "directions": ["z"],
                       "measured_by": [1]}],
        "markers": [{"id": 1, "point": [0.01, 0.01, 0.1]}],
        "solver": {"newton_iterations": 3, "residual_tolerance": 1e-5},
    }  # fmt: skip


@pytest.fixture(scope="session")
def half_trained(tmp_path_factory) -> Path:
    """Scene file of a small Diamond whose reduced body was trained on half of what its cables wind.

    It has 24 modes in use and 24 spare ones, of 128 equilibria with each cable wound by up to 11 mm.
    """
    import numpy as np
    import yaml

    from softrobot_twin.scene import load_scene
    from softrobot_twin.scene.loading import written_out
    from softrobot_twin.simulation.building.reduced_body import (
        reduction_fingerprints,
        write_body_reduction,
    )
    from softrobot_twin.study.body_training import reduction_of, train
    from softrobot_twin.study.reduction_basis import rest_stiffness
    from softrobot_twin.study.reduction_states import (
        Sampling,
        StateFinder,
        chains,
        joined,
        samples_of,
        spread_of,
        training_scene,
    )
    from softrobot_twin.study.training_options import TrainingOptions
    from softrobot_twin.study.workspace import sampled_axes

    root, folder = Path(__file__).parents[1], tmp_path_factory.mktemp("half_trained")
    mapping = written_out(yaml.safe_load((root / "config/scenes/diamond.yaml").read_text()))
    mapping["body"]["mesh"]["file"] = str(root / "meshes/diamond_150.vtk")
    mapping["body"]["element"] = "linear"
    scene = folder / "scene.yaml"
    scene.write_text(yaml.safe_dump(mapping))
    sampling = Sampling("body")
    finder = StateFinder(training_scene(load_scene(scene), sampling), "body")
    names = [cable["name"] for cable in mapping["cables"]]
    axes = sampled_axes(finder.simulation, [f"{name}_shortening_m=0:0.011" for name in names])
    samples = samples_of(finder.simulation, axes, sampling, (), 128, 0, True)
    states = joined([finder(samples[tour]) for tour in chains(samples, spread_of(samples))])
    body = finder.simulation.model.bodies[0]
    trained = train(body, rest_stiffness(body), states, 24, TrainingOptions(spare=24), 0.003)
    reduction = reduction_of(body, trained, np.full(2, np.nan), {})
    write_body_reduction(folder / "body.npz", reduction, reduction_fingerprints(body))
    mapping["body"]["reduced"] = {"file": "body.npz"}
    scene.write_text(yaml.safe_dump(mapping))
    return scene


@pytest.fixture(autouse=True)
def _own_state(tmp_path_factory, monkeypatch):
    """No test continues from the last command of another one, or of a real robot."""
    home = tmp_path_factory.getbasetemp() / f"state_{next(_STATES)}"
    monkeypatch.setenv("XDG_STATE_HOME", str(home))


_STATES = itertools.count()


@pytest.fixture
def drawn_rng():
    """A generator of random numbers from a drawn seed, which is printed; `DRAWN_SEED` sets it."""
    import numpy as np

    seed = int(os.environ.get("DRAWN_SEED", np.random.SeedSequence().entropy % 2**32))
    print(f"DRAWN_SEED={seed}")
    return np.random.default_rng(seed)


@pytest.fixture
def fatigue(monkeypatch):
    """Adds an effect from a file outside of the package to all scenes."""
    from softrobot_twin.simulation.effects.effects import EFFECTS

    effect = runpy.run_path(Path(__file__).with_name("fatigue_effect.py"))["Fatigue"]
    monkeypatch.setattr("softrobot_twin.simulation.effects.effects.EFFECTS",
                        [*EFFECTS, lambda model: [effect(model)]])  # fmt: skip
