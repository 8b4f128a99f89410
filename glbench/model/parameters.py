"""The parameters p of the submodels, in the order of their vectors.

These records give the equations names that a type checker knows. Unit, meaning, source and values stand in parameters.csv
(read by parameter_table.py); named sets, overrides and checks are in parameter_sets.py.
"""

from __future__ import annotations

from typing import NamedTuple

from glbench.model.expressions import Expr


class ClimateParameters(NamedTuple):
    """Physics, house and equipment: one value for each parameter, a number, a column of a batch, or a symbol."""

    # physics and canopy
    alfa_leaf_air: Expr
    L: Expr
    sigma: Expr
    eps_can: Expr
    eps_sky: Expr
    eta_glob_nir: Expr
    eta_glob_par: Expr
    eta_mg_ppm: Expr
    eta_roof_thr: Expr
    rho_air0: Expr
    rho_can_par: Expr
    rho_can_nir: Expr
    rho_steel: Expr
    rho_water: Expr
    gamma_psych: Expr
    omega: Expr
    cap_leaf: Expr
    c_evap1: Expr
    c_evap2: Expr
    c_evap3_day: Expr
    c_evap3_night: Expr
    c_evap4_day: Expr
    c_evap4_night: Expr
    c_p_air: Expr
    c_p_steel: Expr
    c_p_water: Expr
    g: Expr
    h_so1: Expr
    h_so2: Expr
    h_so3: Expr
    h_so4: Expr
    h_so5: Expr
    k1_par: Expr
    k2_par: Expr
    k_nir: Expr
    k_fir: Expr
    m_air: Expr
    h_so_out: Expr
    m_water: Expr
    R: Expr
    r_can_sp: Expr
    r_b: Expr
    r_s_min: Expr
    s_rs_slope: Expr
    # house and its vents
    eta_glob_air: Expr
    psi: Expr
    a_flr: Expr
    a_cov: Expr
    h_air: Expr
    h_gh: Expr
    c_hec_in: Expr
    c_hec_out1: Expr
    c_hec_out2: Expr
    c_hec_out3: Expr
    h_elevation: Expr
    a_roof: Expr
    h_vent: Expr
    eta_ins_scr: Expr
    a_side: Expr
    c_dgh: Expr
    c_leakage: Expr
    c_wgh: Expr
    h_side_roof: Expr
    # roof
    eps_rf_fir: Expr
    rho_rf: Expr
    rho_rf_nir: Expr
    rho_rf_par: Expr
    rho_rf_fir: Expr
    tau_rf_nir: Expr
    tau_rf_par: Expr
    tau_rf_fir: Expr
    lambda_rf: Expr
    c_p_rf: Expr
    h_rf: Expr
    # thermal screen
    eps_th_scr_fir: Expr
    rho_th_scr: Expr
    rho_th_scr_nir: Expr
    rho_th_scr_par: Expr
    rho_th_scr_fir: Expr
    tau_th_scr_nir: Expr
    tau_th_scr_par: Expr
    tau_th_scr_fir: Expr
    c_p_th_scr: Expr
    h_th_scr: Expr
    k_th_scr: Expr
    # blackout screen
    eps_bl_scr_fir: Expr
    rho_bl_scr: Expr
    rho_bl_scr_nir: Expr
    rho_bl_scr_par: Expr
    tau_bl_scr_nir: Expr
    tau_bl_scr_par: Expr
    tau_bl_scr_fir: Expr
    c_p_bl_scr: Expr
    h_bl_scr: Expr
    k_bl_scr: Expr
    # floor
    eps_flr: Expr
    rho_flr: Expr
    rho_flr_nir: Expr
    rho_flr_par: Expr
    lambda_flr: Expr
    c_p_flr: Expr
    h_flr: Expr
    # soil
    rho_cp_so: Expr
    lambda_so: Expr
    # rail pipes
    eps_pipe: Expr
    phi_pipe_e: Expr
    phi_pipe_i: Expr
    l_pipe: Expr
    # installed capacities
    p_boil: Expr
    phi_ext_co2: Expr
    # derived from the entries above
    cap_pipe: Expr
    rho_air_cap: Expr
    cap_air: Expr
    cap_flr: Expr
    cap_so1: Expr
    cap_so2: Expr
    cap_so3: Expr
    cap_so4: Expr
    cap_so5: Expr
    cap_th_scr: Expr
    cap_top: Expr
    cap_bl_scr: Expr
    cap_co2_air: Expr
    cap_co2_top: Expr
    a_pipe: Expr
    f_can_flr: Expr
    pressure: Expr
    # not read by the equations
    energy_content_gas: Expr
    # grow pipes
    eps_gro_pipe: Expr
    l_gro_pipe: Expr
    phi_gro_pipe_e: Expr
    phi_gro_pipe_i: Expr
    a_gro_pipe: Expr
    p_boil_gro: Expr
    cap_gro_pipe: Expr
    # top lamps
    theta_lamp_max: Expr
    heat_correction: Expr
    eta_lamp_par: Expr
    eta_lamp_nir: Expr
    tau_lamp_par: Expr
    tau_lamp_nir: Expr
    tau_lamp_fir: Expr
    rho_lamp_par: Expr
    rho_lamp_nir: Expr
    a_lamp: Expr
    eps_lamp_top: Expr
    eps_lamp_bottom: Expr
    cap_lamp: Expr
    c_hec_lamp_air: Expr
    eta_lamp_cool: Expr
    zeta_lamp_par: Expr
    # interlights
    int_lamps: Expr
    v_int_lamp_pos: Expr
    f_int_lamp_down: Expr
    cap_int_lamp: Expr
    eta_int_lamp_par: Expr
    eta_int_lamp_nir: Expr
    a_int_lamp: Expr
    eps_int_lamp: Expr
    theta_int_lamp_max: Expr
    zeta_int_lamp_par: Expr
    c_hec_int_lamp_air: Expr
    tau_int_lamp_fir: Expr
    k1_int_par: Expr
    k2_int_par: Expr
    k_int_nir: Expr
    k_int_fir: Expr
    # house and its vents
    c_leak_top: Expr
    min_wind: Expr
    # not read by the equations
    dmfm: Expr
    eps: Expr


class TomatoParameters(NamedTuple):
    """The tomato crop."""

    glob_jt_umol: Expr
    j25_leaf_max: Expr
    c_gamma: Expr
    eta_co2_air_stom: Expr
    e_j: Expr
    t25k: Expr
    S: Expr
    H: Expr
    theta: Expr
    alpha: Expr
    m_ch2o: Expr
    m_co2: Expr
    par_jto_umol_sun: Expr
    lai_max: Expr
    sla: Expr
    rgr: Expr
    c_leaf_max: Expr
    c_fruit_max: Expr
    c_fruit_g: Expr
    c_leaf_g: Expr
    c_stem_g: Expr
    c_rgr: Expr
    q10m: Expr
    c_fruit_m: Expr
    c_leaf_m: Expr
    c_stem_m: Expr
    rg_fruit: Expr
    rg_leaf: Expr
    rg_stem: Expr
    c_buf_max: Expr
    c_buf_min: Expr
    t_can24_max: Expr
    t_can24_min: Expr
    t_can_max: Expr
    t_can_min: Expr
    t_end_sum: Expr
    t_end_sum_growth: Expr
