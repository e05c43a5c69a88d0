// Poses of currents that any instrument has measured, in this process: for .NET, Mono and Unity.
//
//     mcs SolveCurrents.cs && mono SolveCurrents.exe head.toml calibration.toml < currents.txt
//     mono SolveCurrents.exe wide - 1000 < currents.txt     (no calibration; lines are frames, 1000 a second)
//
// A line has I_X1 and I_X2 of each cell, in ampere, separated by spaces. libslitpose_solver.so (Windows: slitpose_solver.dll) must
// be where libraries are found: beside the program, installed, or in Unity's Assets/Plugins.
using System;
using System.Globalization;
using System.Linq;
using System.Runtime.InteropServices;
using System.Text;

// As in slitpose_solver.h, which describes each field.
[StructLayout(LayoutKind.Sequential)]
public struct Solution
{
    public ulong TimeNs;
    public ushort Status, Reason, HasPose, HasTwist, CellsUsed, ExcludedCells, Redundancy, NoTwist;
    [MarshalAs(UnmanagedType.ByValArray, SizeConst = 3)] public double[] TranslationM;
    [MarshalAs(UnmanagedType.ByValArray, SizeConst = 4)] public double[] RotationXyzw;
    [MarshalAs(UnmanagedType.ByValArray, SizeConst = 36)] public double[] Covariance;
    [MarshalAs(UnmanagedType.ByValArray, SizeConst = 3)] public double[] LinearMPerS;
    [MarshalAs(UnmanagedType.ByValArray, SizeConst = 3)] public double[] AngularRadPerS;
    [MarshalAs(UnmanagedType.ByValArray, SizeConst = 6)] public double[] TwistSigma;
    public double LightLevel, Chi2;
}

/// A solver of one head. One thread at a time may use it.
public sealed class Solver : IDisposable
{
    const string Library = "slitpose_solver";
    const uint Abi = 1;

    [DllImport(Library)] static extern uint slitpose_solver_abi();
    [DllImport(Library)] static extern IntPtr slitpose_solver_open(byte[] scene, byte[] calibration, byte[] error, UIntPtr bytes);
    [DllImport(Library)] static extern void slitpose_solver_close(IntPtr solver);
    [DllImport(Library)] static extern UIntPtr slitpose_solver_cells(IntPtr solver);
    [DllImport(Library)] static extern UIntPtr slitpose_solver_error(IntPtr solver, byte[] buffer, UIntPtr bytes);
    [DllImport(Library)] static extern int slitpose_solver_solve(IntPtr solver, double[] currents, UIntPtr count, out Solution found);
    [DllImport(Library)] static extern int slitpose_solver_start(IntPtr solver, double rateHz, double[] exposures, UIntPtr count);
    [DllImport(Library)] static extern int slitpose_solver_track(IntPtr solver, ulong timeNs, double[] currents, UIntPtr count, out Solution found);

    IntPtr handle;

    public Solver(string scene, string calibration)
    {
        if (slitpose_solver_abi() != Abi)
            throw new InvalidOperationException("the library has interface " + slitpose_solver_abi() + ", this program " + Abi);
        var error = new byte[1024];
        handle = slitpose_solver_open(Utf8(scene), Utf8(calibration), error, (UIntPtr)error.Length);
        if (handle == IntPtr.Zero)
            throw new ArgumentException(Text(error));
    }

    public int Cells { get { return (int)slitpose_solver_cells(handle); } }

    public Solution Solve(double[] currents)
    {
        Solution found;
        Check(slitpose_solver_solve(handle, currents, (UIntPtr)currents.Length, out found));
        return found;
    }

    public void Start(double rateHz)
    {
        Check(slitpose_solver_start(handle, rateHz, null, UIntPtr.Zero));
    }

    public Solution Track(ulong timeNs, double[] currents)
    {
        Solution found;
        Check(slitpose_solver_track(handle, timeNs, currents, (UIntPtr)currents.Length, out found));
        return found;
    }

    public void Dispose()
    {
        slitpose_solver_close(handle);
        handle = IntPtr.Zero;
    }

    void Check(int result)
    {
        if (result == 0)
            return;
        var error = new byte[1024];
        slitpose_solver_error(handle, error, (UIntPtr)error.Length);
        throw new ArgumentException(Text(error));
    }

    static byte[] Utf8(string text)
    {
        return text == null ? null : Encoding.UTF8.GetBytes(text + "\0");
    }

    static string Text(byte[] bytes)
    {
        return Encoding.UTF8.GetString(bytes, 0, Array.IndexOf(bytes, (byte)0));
    }
}

static class Program
{
    static readonly string[] Statuses = { "converged", "degraded", "ambiguous", "unobservable", "too_dark", "diverged" };

    static string Numbers(string name, params double[] numbers)
    {
        return " " + name + string.Concat(numbers.Select(number => " " + number.ToString("G17", CultureInfo.InvariantCulture)));
    }

    static int Main(string[] arguments)
    {
        if (arguments.Length < 2)
        {
            Console.Error.WriteLine("usage: SolveCurrents SCENE CALIBRATION|- [FRAMES_PER_SECOND]");
            return 2;
        }
        try
        {
            double rateHz = arguments.Length > 2 ? double.Parse(arguments[2], CultureInfo.InvariantCulture) : 0;
            using (var solver = new Solver(arguments[0], arguments[1] == "-" ? null : arguments[1]))
            {
                if (rateHz > 0)
                    solver.Start(rateHz);
                string line;
                for (ulong frame = 0; (line = Console.ReadLine()) != null; frame++)
                {
                    double[] currents = line.Split(new[] { ' ' }, StringSplitOptions.RemoveEmptyEntries)
                        .Select(word => double.Parse(word, CultureInfo.InvariantCulture)).ToArray();
                    Solution found = rateHz > 0 ? solver.Track((ulong)(1e9 / rateHz * frame), currents) : solver.Solve(currents);
                    Console.Write("{0} {1}", Statuses[found.Status], found.CellsUsed);
                    if (found.HasPose != 0)
                        Console.Write(Numbers("t", found.TranslationM) + Numbers("q", found.RotationXyzw)
                            + Numbers("variance", found.Covariance[0], found.Covariance[7], found.Covariance[14]) + Numbers("chi2", found.Chi2));
                    if (found.HasTwist != 0)
                        Console.Write(Numbers("v", found.LinearMPerS));
                    Console.WriteLine();
                }
            }
            return 0;
        }
        catch (ArgumentException error)
        {
            Console.Error.WriteLine(error.Message);
            return 1;
        }
    }
}
